"""Guided self-calibration: samples to 5 mm against random positions, tensions, verdicts.

``python -m benchmarks.calibration_guide [ROBOTS [DRIVEN]]``: robots whose platform is put by a
simulated hand, as only samples count there, and robots that are moved by their driver.
"""

from __future__ import annotations

import sys
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

import carosac_toolkit as ct
from benchmarks.results import table, write_section
from calibration.guide.drivers import enable_where_it_is, guarded, simulated_driver
from calibration.guide.fit import GuideFit
from calibration.guide.guide import Guide
from calibration.guide.hand import HandMover
from calibration.guide.mover import DriverMover
from calibration.guide.samples import SampleFile
from calibration.guide.settings import GuideSettings
from calibration.guide.simulated import SimulatedHand, draw_true_robot, taped_distance
from calibration.guide.verdict import Verdict, aligned_errors
from calibration.self_calibration.settings import SelfCalibrationSettings
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import CarosacError
from carosac_toolkit.robot.robot import Robot

COMMAND = "python -m benchmarks.calibration_guide"
ROBOTS, DRIVEN = 50, 10
SETTINGS = GuideSettings(accuracy=5e-3, max_samples=120)
LIMITS_N = (1.0, 60.0)  # [N] of driven robots: those of the file would hardly be met


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """One guided robot: samples, true mean error of the exit points [m], CPU time [s]."""

    samples: int
    reached: bool
    error: float
    cpu: float


@dataclass(frozen=True, kw_only=True)
class Drive:
    """One robot that was moved by its driver."""

    outcome: Outcome
    tension: tuple[float, float]
    duration: float
    holds: bool
    position_error: float


class Watched:
    """A driver whose true tensions are noted in every cycle."""

    def __init__(self, driver: Any) -> None:
        """Watch a simulated driver."""
        self._driver = driver
        self.tension: list[Array] = []

    def __getattr__(self, name: str) -> Any:
        """Return what the driver has."""
        return getattr(self._driver, name)

    def wait(self, duration: float) -> bool:
        """Wait, and note the true tensions."""
        going_on = bool(self._driver.wait(duration))
        self.tension.append(self._driver.truth().tension[0])
        return going_on


def limited_robot() -> Robot:
    """Return the robot of the file with narrower tension limits."""
    robot = ct.load_robot("hangprinter")
    low, high = (np.full(robot.n, limit) for limit in LIMITS_N)
    return replace(robot, tension_min=low, tension_max=high)


def exit_error(fit: GuideFit, true: Robot, home: Array) -> float:
    """Return the mean distance of the exit points from the truth after a turn about home [m]."""
    arm = fit.known.exit_points - fit.known.problem.robot.home_position
    true_arm = true.exit_points - home
    turn, _ = Rotation.align_vectors(true_arm, arm)
    return float(np.linalg.norm(turn.apply(arm) - true_arm, axis=1).mean())


def priors(true: Robot, seed: int) -> SelfCalibrationSettings:
    """Return what is known before: one distance by tape."""
    tape = taped_distance(true, "a", "b", seed)
    return SelfCalibrationSettings(friction_share=0.0, distances=(tape,))


def by_hand(robot: Robot, seed: int, *, at_random: bool) -> Outcome:
    """Guide a hand, or have it go to random positions."""
    true = draw_true_robot(robot, np.random.default_rng(seed))
    hand = SimulatedHand(robot, true, np.random.default_rng((seed, 1)))
    home, began = hand.position, process_time()
    with tempfile.TemporaryDirectory() as folder:
        guide = Guide(
            robot, HandMover(hand.place, hand.read), SampleFile(Path(folder) / "s.csv", robot),
            SETTINGS, priors(true, seed), seed=seed, at_random=at_random,
        )  # fmt: skip
        guide.resume()
        count = len(list(guide.collect()))
    assert guide.fit is not None
    return Outcome(
        samples=count, reached=guide.accurate, error=exit_error(guide.fit, true, home),
        cpu=process_time() - began,
    )  # fmt: skip


def driven(robot: Robot, seed: int) -> Drive:
    """Guide a robot by its driver, and check its verdict."""
    true = draw_true_robot(robot, np.random.default_rng(seed))
    driver = Watched(simulated_driver(robot, true, SETTINGS, seed=seed))
    guard = guarded(driver, robot, SETTINGS)
    enable_where_it_is(guard, robot)
    began = process_time()
    mover = DriverMover(guard, robot, SETTINGS, real_time=False)
    places: list[Array] = []
    with tempfile.TemporaryDirectory() as folder:
        samples = SampleFile(Path(folder) / "s.csv", robot)
        guide = Guide(robot, mover, samples, SETTINGS, priors(true, seed), seed=seed)
        guide.resume()
        for _ in guide.collect():
            places.append(driver.truth().position[0])
        assert guide.fit is not None
        predicted = list(guide.fit.position)
        for check in guide.check():
            places.append(driver.truth().position[0])
            predicted.append(check.position)
    verdict = Verdict(checks=guide.checked)
    error = aligned_errors(predicted, places, robot.home_position)[-SETTINGS.checks :]
    tension = np.array(driver.tension)
    return Drive(
        outcome=Outcome(
            samples=len(guide.fit.position), reached=guide.accurate,
            error=exit_error(guide.fit, true, places[0]), cpu=process_time() - began,
        ),
        tension=(float(tension.min()), float(tension.max())),
        duration=len(tension) * SETTINGS.period,
        holds=verdict.holds,
        position_error=float(np.sqrt(np.mean(error**2))),
    )  # fmt: skip


def rows_by_hand(robot: Robot, count: int) -> list[tuple[str, ...]]:
    """Return one line for the guide and one for random positions."""
    rows: list[tuple[str, ...]] = []
    for name, at_random in (("guide", False), ("random positions", True)):
        outcomes = [by_hand(robot, seed, at_random=at_random) for seed in range(count)]
        samples = np.array([o.samples for o in outcomes])
        error = 1e3 * np.array([o.error for o in outcomes])
        rows.append(
            (
                name, f"{sum(o.reached for o in outcomes)} of {count}", f"{np.median(samples):.0f}",
                f"{np.quantile(samples, 0.95):.0f}", f"{np.median(error):.1f}",
                f"{np.quantile(error, 0.95):.1f}", f"{np.median([o.cpu for o in outcomes]):.1f}",
            )
        )  # fmt: skip
        print(rows[-1], flush=True)
    return rows


def rows_driven(robot: Robot, count: int) -> list[tuple[str, ...]]:
    """Return one line for each robot that was moved by its driver."""
    rows: list[tuple[str, ...]] = []
    for seed in range(count):
        try:
            drive = driven(robot, seed)
        except CarosacError as error:
            rows.append((str(seed), f"ended: {error}", *["-"] * 6))
            print(rows[-1], flush=True)
            continue
        found = drive.outcome
        rows.append(
            (
                str(seed), f"{found.samples}{'' if found.reached else ', not reached'}",
                f"{1e3 * found.error:.1f}", f"{drive.tension[0]:.1f}", f"{drive.tension[1]:.1f}",
                f"{drive.duration / 60.0:.0f}", f"{1e3 * drive.position_error:.1f}",
                "holds" if drive.holds else "does not hold",
            )
        )  # fmt: skip
        print(rows[-1], flush=True)
    return rows


def main() -> None:
    """Measure and write the section."""
    counts = [int(word) for word in sys.argv[1:]]
    count, moved = [*counts, *(ROBOTS, DRIVEN)[len(counts) :]]
    robot, limited = ct.load_robot("hangprinter"), limited_robot()
    header = (
        "positions", "reached", "samples, median", "95 %", "true mean error of the exit points, "
        "median [mm]", "95 % [mm]", "CPU time, median [s]",
    )  # fmt: skip
    driven_header = (
        "robot", "samples", "true mean error of the exit points [mm]", "least true tension [N]",
        "largest [N]", "time of the robot [min]", "predicted positions, RMS error [mm]", "verdict",
    )  # fmt: skip
    body = (
        f"Robots that `hangprinter` may be a first guess of ({robot.n} cables): exit points off by "
        "8 % of the longest cable sideways and by 1.5 % in height, distances from home by 20 mm, "
        "drum radius by 1 %, build-up by 15 %, stiffness by 30 %, mass by 2 %; one distance by "
        "tape to 1 mm. Wanted: "
        f"{1e3 * SETTINGS.accuracy:g} mm, the claimed mean distance of the exit points from the "
        f"truth. {count} robots are moved by hand, which misses by 2 % of the longest cable, with "
        "0.5 mm of noise of the line at each rest; random positions are uniform over what is safe "
        "to reach.\n\n" + table(header, rows_by_hand(robot, count)) + f"\n\n{moved} robots are "
        f"moved by their driver behind the guard, with tension limits {LIMITS_N[0]:g} N to "
        f"{LIMITS_N[1]:g} N; tensions are those of every cycle of 20 ms. Then ten moves are "
        "predicted before they are made.\n\n" + table(driven_header, rows_driven(limited, moved))
    )
    write_section("calibration-guide", "Guided self-calibration", COMMAND, body)


if __name__ == "__main__":
    main()
