"""Calibration from lengths and poses: accuracy, consistency, blunders, time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from time import perf_counter, process_time

import numpy as np
from scipy.stats import chi2

import carosac_toolkit as ct
from benchmarks.results import table, write_section
from calibration import (
    LengthCalibration,
    LengthScene,
    LengthSceneSettings,
    LengthSettings,
    MixUp,
    Unobservable,
    calibrate_lengths,
    draw_length_scene,
)
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.robot.robot import Robot

COMMAND = "python -m benchmarks.calibration_lengths"
SCENES = 50
TACHYMETER = 1e-3  # [m]
# Only exit points (by the stated prior) and offsets are wrong, and the calibration knows that.
ALONE = LengthSettings(
    anchor_prior=1e-6, scale_prior=1e-7, delay_prior=1e-6, tilt_prior=1e-6, center_prior=1e-6
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Outcome:
    """One scene: errors of the exit points [m] (n,), squared normalised errors, blunders, time."""

    error: Array
    exits: float
    everything: float
    unknowns: int
    made: int
    missed: int
    invented: int
    wall: float
    cpu: float


def with_pulleys(name: str, sigma: float | None) -> Robot:
    """A bundled robot over pulleys of 5 cm."""
    robot = ct.load_robot(name)
    n = robot.n
    return replace(
        robot,
        pulley_radius=np.full(n, 0.05),
        swivel_axis=np.tile([0.0, 0.0, 1.0], (n, 1)),
        exit_covariance=None if sigma is None else np.tile(sigma**2 * np.eye(3), (n, 1, 1)),
    )


def judge(scene: LengthScene, found: LengthCalibration, wall: float, cpu: float) -> Outcome:
    """Compare a calibration with the truth."""
    estimate = found.estimate
    error = estimate.value - np.array([scene.truth[name] for name in estimate.names])
    exits = np.array([k for k, name in enumerate(estimate.names) if name.startswith("exit")])
    block = estimate.covariance[np.ix_(exits, exits)]
    truth = scene.outlier[found.sample]
    return Outcome(
        error=np.linalg.norm(error[exits].reshape(-1, 3), axis=1),
        exits=float(error[exits] @ np.linalg.solve(block, error[exits])),
        everything=float(error @ np.linalg.solve(estimate.covariance, error)),
        unknowns=len(error),
        made=int(truth.sum()),
        missed=int((truth & ~found.outlier).sum()),
        invented=int((found.outlier & ~truth).sum()),
        wall=wall,
        cpu=cpu,
    )


def run(name: str, sigma: float | None, known: LengthSettings) -> list[Outcome]:
    """Calibrate `SCENES` random robots."""
    robot = with_pulleys(name, sigma)
    outcomes = []
    for seed in range(SCENES + 1):
        scene = draw_length_scene(robot, np.random.default_rng(seed), prior=known)
        wall, cpu = perf_counter(), process_time()
        found = calibrate_lengths(scene.recording, robot, settings=known)
        outcomes.append(judge(scene, found, perf_counter() - wall, process_time() - cpu))
    return outcomes[1:]  # the first one loads libraries and kernels


def row(name: str, prior: str, wrong: str, outcomes: list[Outcome]) -> tuple[str, ...]:
    """A line of the table."""
    error = 1e3 * np.array([o.error for o in outcomes])
    cables = error.shape[1]
    return (
        f"{name}, {cables} cables",
        prior,
        wrong,
        f"{np.median(error):.2f}",
        f"{np.sqrt((error**2).mean() / 3.0):.2f}",
        f"{np.quantile(error, 0.95):.2f}",
        f"{error.max():.1f}",
        consistency([o.exits for o in outcomes], 3 * cables),
        consistency([o.everything for o in outcomes], outcomes[0].unknowns),
        f"{sum(o.missed for o in outcomes)} of {sum(o.made for o in outcomes)}",
        f"{np.mean([o.invented for o in outcomes]):.1f}",
        f"{np.median([o.cpu for o in outcomes]):.2f}",
        f"{np.median([o.wall for o in outcomes]):.2f}",
    )


def consistency(total: list[float], unknowns: int) -> str:
    """Mean squared normalised error per unknown, with its 95 % band."""
    count = unknowns * len(total)
    low, high = chi2.ppf([0.025, 0.975], count) / count
    return f"{sum(total) / count:.3f} ({low:.2f}-{high:.2f})"


def refused() -> list[tuple[str, str]]:
    """What is refused, and with which words."""
    robot = with_pulleys("cogiro", None)
    rng = np.random.default_rng(0)
    scene = draw_length_scene(robot, rng, settings=LengthSceneSettings(samples=200))
    poor = {
        "200 poses within 4 cm": ((0.005, 0.008, 0.016), 200),
        "200 poses on a line of 8 m": ((1.0, 0.001, 0.001), 200),
        "200 poses within a box of 0.8 x 0.5 x 0.25 m": ((0.1, 0.1, 0.1), 200),
    }
    rows = []
    for what, (spread, samples) in poor.items():
        settings = LengthSceneSettings(samples=samples, spread=spread, turn=0.01)
        recording = draw_length_scene(robot, rng, settings=settings).recording
        rows.append((what, said(lambda r=recording: calibrate_lengths(r, robot))))  # type: ignore[misc]
    rows.append(("6 poses", said(lambda: calibrate_lengths(scene.recording.slice(0, 6), robot))))
    order = np.arange(8)
    order[[2, 5]] = 5, 2
    swapped = replace(
        scene.recording, unstrained_length=scene.recording.unstrained_length[:, order]
    )
    rows.append(("readings 3 and 6 swapped", said(lambda: calibrate_lengths(swapped, robot))))
    wrong = replace(scene.recording, unstrained_length=1e3 * scene.recording.unstrained_length)
    rows.append(("lengths in millimetres", said(lambda: calibrate_lengths(wrong, robot))))
    return rows


def said(call: Callable[[], object]) -> str:
    """The first lines of a refusal."""
    try:
        call()
    except (Unobservable, MixUp) as error:
        return " ".join(line.strip() for line in str(error).splitlines()[:2])
    return "accepted"


def main() -> None:
    """Measure and write the section."""
    rows = []
    for name in ("carosac", "cogiro"):
        for prior, sigma in (("5 cm", None), ("1 mm, tachymeter", TACHYMETER)):
            for wrong, known in (("all", LengthSettings()), ("exit points and offsets", ALONE)):
                rows.append(row(name, prior, wrong, run(name, sigma, known)))
                print(rows[-1], flush=True)
    header = (
        "robot", "exit points known to", "what is wrong", "error, median [mm]",
        "RMS per axis [mm]", "95 %", "largest",
        "NEES of the exit points (95 % band)", "NEES of all parameters", "blunders missed",
        "good readings left out, per scene", "CPU time [s]", "wall time, shared machine [s]",
    )  # fmt: skip
    body = (
        f"{SCENES} random robots a line: exit points off by the stated prior per axis, offsets by "
        "0.2 m and, where all is wrong, anchor points by 2 mm, scales by 0.1 %, the centre of mass "
        "by 1 cm, the delay by 0.1 s, the frame of the poses tilted by 5 mrad; sag, stretch, "
        "pulleys of 5 cm; 500 poses along the edges of the workspace, motion capture 1 mm and 0.5 "
        "mrad, readings 2 mm, 5 % of them 5-50 cm off. Errors are distances in space of all exit "
        "points; NEES is per parameter, 1 is right. Times are medians of `calibrate`, checks "
        "included.\n\n"
        + table(header, rows)
        + "\n\n"
        + table(("what is wrong", "the refusal begins"), refused())
    )
    write_section("calibration-lengths", "Calibration from lengths and poses", COMMAND, body)


if __name__ == "__main__":
    main()
