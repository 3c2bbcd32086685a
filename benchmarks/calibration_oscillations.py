"""Identification from many short free oscillations of robots with pulleys, dry friction and tilt.

Run it from the project's root: ``python -m benchmarks.calibration_oscillations [--seeds N]
[--cables N ...] [--apart]``. Each robot takes some minutes and is kept in
``benchmarks/oscillations``, with a digest of the code that identified it, so that a run goes on
where another one of the same code ended; the section is written from all of that code. With
``--apart`` each core identifies a robot of its own: that is faster for many, and does not tell how
long one takes on two cores.
"""

from __future__ import annotations

import argparse
import ast
import hashlib
import json
import multiprocessing
import os
import sys
from dataclasses import asdict, dataclass, replace
from functools import cache
from itertools import product
from pathlib import Path
from time import perf_counter, process_time

import numpy as np
from scipy.stats import chi2

import carosac_toolkit as ct
from benchmarks.results import write_section
from calibration import IdentificationSettings, identification, identify_runs
from calibration.estimate import ParameterEstimate
from calibration.identification.result import Identification
from calibration.identification.synthetic_oscillations import (
    OscillationSettings,
    simulate_oscillations,
)
from calibration.identification.unknowns import choose_coordinates
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import CarosacError
from carosac_toolkit.base.files import replacing
from carosac_toolkit.base.tables import counted
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.physics.rest.modes import natural_frequencies
from carosac_toolkit.recordings.encoders import unstrained_lengths
from carosac_toolkit.recordings.recording import Recording
from carosac_toolkit.robot.parameter_names import field_of
from carosac_toolkit.robot.parameters import values_of
from carosac_toolkit.robot.robot import Robot
from tests.robots import hanging

KEPT = Path(__file__).parent / "oscillations"
CABLES = (3, 4)
TITLE = "Identification from free oscillations"
PULLEY_RADIUS_M = 0.04
NEES_FAR = 2.0  # of one robot, which chance hardly reaches
DRAWN_SIGMAS_MAX = 2.0  # prior sigmas: no truth is drawn farther away
FRICTION_SIGMAS = (0.7, 2.0)  # range of dry friction, in its prior sigmas
FRICTION = ("exit_friction", "anchor_friction")
# Beside the factors of an estimate, what one factor of all forces and masses multiplies: motion
# hardly tells it, so that all of these are known along a line of their logarithms.
ALIKE = ("inertia", *FRICTION)
# A robot whose geometry was surveyed and whose lengths were calibrated; winches are locked.
SURVEYED = IdentificationSettings(
    exit_points=1e-3, anchor_points=5e-4, length_offset=2e-3, length_scale=0.0, length_delay=0.0,
    length_hysteresis=0.0,
)  # fmt: skip


def robot_with_pulleys(cables: int) -> Robot:
    """Return a robot of 3 or 4 cables with pulleys."""
    robot = ct.load_robot("carosac") if cables == 4 else hanging(cables)
    return replace(robot, pulley_radius=np.full(cables, PULLEY_RADIUS_M))


def draw_plant(robot: Robot, settings: IdentificationSettings, seed: int) -> Robot:
    """Draw a robot from what is known before, with dry friction."""
    unknowns = choose_coordinates(robot, settings)
    rng = np.random.default_rng([seed, 8])
    names = unknowns.prior.names
    point = np.clip(rng.standard_normal(len(names)), -DRAWN_SIGMAS_MAX, DRAWN_SIGMAS_MAX)
    for k, name in enumerate(names):
        if name in FRICTION:
            point[k] = rng.uniform(*FRICTION_SIGMAS)
    return unknowns.robot_at(np.maximum(point, unknowns.lower))


@dataclass(frozen=True, kw_only=True)
class Score:
    """Errors of an identified robot.

    Attributes:
        frequency: Largest share by which a slow mode is off [1].
        friction: The same of dry moments [1].
        tilt: [rad].
        center: Of mass [m].
        nees: Normalised squared error of the parameters, over their number; of all that is in
            proportion to forces or masses, that of logarithms, and of a cable's stiffness that of
            its EA over its whole length [1].
        beyond: Parameters that are off by more than three sigmas.
        worst: The worst of them.
        count: How many parameters were identified.
        seconds: Time of processors [s].
        wall: Time by the clock on two cores [s]; None: it ran on one.
        left_out: Recordings that tell of the robot by chance.
        code: Digest of the code that identified it.
    """

    frequency: float
    friction: float
    tilt: float
    center: float
    nees: float
    beyond: int
    worst: str
    count: int
    seconds: float = 0.0
    wall: float | None = None
    left_out: int = 0
    code: str = ""


def score(result: Identification, plant: Robot, runs: list[Recording]) -> Score:
    """Compare an identified robot with the true one."""
    estimate, reach = result.estimate, choose_coordinates(result.before, SURVEYED).reach
    shares = errors_along_curves(estimate, values_of(plant, estimate.names), reach) / estimate.sigma
    worst = int(np.argmax(np.abs(shares)))

    def off_by(name: str) -> float:
        return float(abs(values_of(result.robot, [name]) / values_of(plant, [name]) - 1.0)[0])

    tilt = values_of(result.robot, ["pose_tilt.x", "pose_tilt.y"])
    return Score(
        frequency=max(_frequency_error(result.robot, plant, run) for run in runs),
        friction=max(off_by(name) for name in estimate.names if name in FRICTION),
        tilt=float(np.linalg.norm(tilt - values_of(plant, ["pose_tilt.x", "pose_tilt.y"]))),
        center=float(np.linalg.norm(result.robot.center_of_mass - plant.center_of_mass)),
        nees=float(shares @ np.linalg.solve(estimate.correlation, shares) / len(shares)),
        beyond=int((np.abs(shares) > 3.0).sum()),
        worst=f"{abs(shares[worst]):.1f} {estimate.names[worst]}",
        count=len(shares),
    )


def errors_along_curves(estimate: ParameterEstimate, true: Array, reach: float) -> Array:
    """Return errors of parameters, along the curves on which their covariance knows them.

    What is in proportion to forces or masses is known by its logarithm. Motion shows the EA of a
    cable over its whole length; a covariance tells how that changes with the length to first order.

    Args:
        estimate: k parameters.
        true: Of the robot that moved, shape (k,).
        reach: Mean length of the cables at home [m], without their run.

    Returns:
        shape (k,), in units of the parameters.
    """
    names, value = estimate.names, estimate.value
    alike = [name in estimate.factors or field_of(name) in ALIKE for name in names]
    factor = np.array(alike) & (value > 0.0)  # friction may be found to be none
    off = value - true
    off[factor] = value[factor] * np.log(value[factor] / true[factor])
    if "run_length" in names and "axial_stiffness" in names:
        run, stiffness = names.index("run_length"), names.index("axial_stiffness")
        whole, whole_true = reach + value[run], reach + true[run]
        bend = np.log(whole / whole_true) - (whole - whole_true) / whole
        off[stiffness] -= value[stiffness] * bend
    return off


def _frequency_error(found: Robot, plant: Robot, run: Recording) -> float:
    """Return the largest share by which a slow mode of one recording is off."""
    reading = run.unstrained_length.mean(axis=0, keepdims=True)
    frequency = [
        natural_frequencies(
            robot, statics.forward_kinematics(robot, unstrained_lengths(robot, reading))
        )[0, : 6 - robot.n]
        for robot in (found, plant)
    ]
    return float(np.abs(frequency[0] / frequency[1] - 1.0).max())


@cache
def digest() -> str:
    """Return a digest of the package that identifies, without what its comments and docs say."""
    code = hashlib.sha256()
    for path in sorted(Path(identification.__file__).parent.glob("*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        for node in ast.walk(tree):
            if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and ast.get_docstring(
                node, clean=False
            ):
                del node.body[0]
        code.update(ast.dump(tree).encode())
    return code.hexdigest()[:12]


@dataclass(frozen=True, kw_only=True)
class Refusal:
    """A robot that was not identified, though all of its recordings are right.

    Attributes:
        refused: Why.
        code: Digest of the code that refused it.
    """

    refused: str
    code: str = ""


def read(path: Path) -> Score | Refusal | None:
    """Return what the same code found of a robot before; None: it was another."""
    if not path.is_file():
        return None
    data = json.loads(path.read_text(encoding="utf-8"))
    found = Refusal(**data) if "refused" in data else Score(**data)
    return found if found.code == digest() else None


def measure(
    cables: int, seed: int, options: OscillationSettings, settings: IdentificationSettings
) -> Score | Refusal:
    """Identify a drawn robot, unless that was kept."""
    path = KEPT / f"{cables}-{seed}.json"
    kept = read(path)
    if kept is not None:
        return kept
    robot = robot_with_pulleys(cables)
    plant = draw_plant(robot, settings, seed)
    runs = simulate_oscillations(plant, seed, options)
    found: Score | Refusal
    wall, used = perf_counter(), process_time()
    try:
        result = identify_runs(runs, robot, settings)
    except CarosacError as error:
        found = Refusal(refused=str(error))
    else:
        wall, used = perf_counter() - wall, process_time() - used
        alone = len(os.sched_getaffinity(0)) > 1
        found = replace(
            score(result, plant, runs),
            seconds=used,
            wall=wall if alone else None,
            left_out=len(result.unfollowed),
        )
    found = replace(found, code=digest())
    KEPT.mkdir(exist_ok=True)
    with replacing(path) as temporary:
        temporary.write_text(json.dumps(asdict(found), indent=1) + "\n", encoding="utf-8")
    return found


def _beyond(values: list[float], bar: float, said: str = "it") -> str:
    """Say how many robots are beyond a bar."""
    count = sum(value > bar for value in values)
    return f"; {counted(count, 'robot')} beyond {said}" if count else ""


def rows_of(cables: int, scores: list[Score]) -> list[str]:
    """Return the rows of the table for robots of some cables."""
    count = sum(one.count for one in scores)
    low, high = chi2.ppf([0.025, 0.975], count) / count
    nees = sum(one.nees * one.count for one in scores) / count
    return [
        f"| {cables} cables, {counted(len(scores), 'robot')} | {what} | {bar} | {value} |"
        for what, bar, value in (
            ("frequencies, worst of all", "0.5 %",
             f"{100.0 * max(s.frequency for s in scores):.2f} %"
             + _beyond([s.frequency for s in scores], 5e-3)),
            ("dry moments, median and worst", "20 %",
             f"{100.0 * np.median([s.friction for s in scores]):.0f}, "
             f"{100.0 * max(s.friction for s in scores):.0f} %"
             + _beyond([s.friction for s in scores], 0.2)),
            ("tilt, median and worst", "1 mrad",
             f"{1e3 * np.median([s.tilt for s in scores]):.2f}, "
             f"{1e3 * max(s.tilt for s in scores):.2f} mrad"
             + _beyond([s.tilt for s in scores], 1e-3)),
            ("centre of mass, median and worst", "2 mm",
             f"{1e3 * np.median([s.center for s in scores]):.2f}, "
             f"{1e3 * max(s.center for s in scores):.2f} mm"
             + _beyond([s.center for s in scores], 2e-3)),
            ("normalised squared error of the parameters over their number, mean and median",
             f"{low:.2f} to {high:.2f}",
             f"{nees:.2f}, {np.median([s.nees for s in scores]):.2f}"
             + _beyond([s.nees for s in scores], NEES_FAR, f"{NEES_FAR:g}")),
            ("beyond three sigmas", "reported", f"{sum(s.beyond for s in scores)} of {count}"),
            ("recordings left out, as what they tell is chance", "reported",
             f"{sum(s.left_out for s in scores)} of {OscillationSettings().count * len(scores)}"),
            ("time of processors, median and longest", "600 s on two cores",
             f"{np.median([s.seconds for s in scores]):.0f}, "
             f"{max(s.seconds for s in scores):.0f} s"),
            *(
                (f"time by the clock on two cores, longest of {counted(len(walls), 'robot')}",
                 "300 s", f"{max(walls):.0f} s")
                for walls in [[s.wall for s in scores if s.wall is not None]]
                if walls
            ),
        )
    ]  # fmt: skip


def _pinned(free: multiprocessing.Queue[int]) -> None:
    """Keep this process to a core of its own."""
    os.sched_setaffinity(0, {free.get()})


def _measured(one: tuple[int, int]) -> str:
    """Measure the robot of some cables and a seed; return a line about it."""
    return f"{one} {measure(*one, OscillationSettings(), SURVEYED)}"


def main() -> None:
    """Measure and write; end with status 1 if a robot was not identified."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--cables", type=int, nargs="+", default=list(CABLES), choices=CABLES)
    parser.add_argument("--apart", action="store_true", help="on each core a robot of its own")
    given = parser.parse_args()
    options = OscillationSettings()
    todo = [(cables, seed) for seed, cables in product(range(given.seeds), given.cables)]
    if given.apart:
        cores = sorted(os.sched_getaffinity(0))
        context = multiprocessing.get_context("spawn")
        free = context.Queue()
        for core in cores:
            free.put(core)
        with context.Pool(len(cores), initializer=_pinned, initargs=(free,)) as pool:
            for line in pool.imap_unordered(_measured, todo, chunksize=1):
                print(line, flush=True)
    else:
        for one in todo:
            print(_measured(one), flush=True)
    rows, refused = [], []
    for cables in CABLES:
        kept = {path.stem: read(path) for path in sorted(KEPT.glob(f"{cables}-*.json"))}
        scores = [each for each in kept.values() if isinstance(each, Score)]
        rows += rows_of(cables, scores) if scores else []
        refused += [
            f"{name}: {each.refused}" for name, each in kept.items() if isinstance(each, Refusal)
        ]
    text = [
        f"{options.count} free oscillations of {options.duration:g} s at {options.rate:g} Hz, none "
        "at rest at the start; robots are drawn from what is known before.",
        *(f"\nNot identified, though all recordings are right: robot {line}." for line in refused),
        "", "| robots | what | bar | measured |", "|---|---|---|---|", *rows,
    ]  # fmt: skip
    command = "python -m benchmarks.calibration_oscillations"
    write_section("calibration-oscillations", TITLE, command, "\n".join(text))
    if refused:
        sys.exit(1)


if __name__ == "__main__":
    main()
