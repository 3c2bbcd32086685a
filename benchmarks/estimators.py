"""Estimators on the same runs: accuracy, consistency, faults, workspace, each part a section."""

from __future__ import annotations

import argparse
import multiprocessing
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.estimator_runs import (
    ACCELERATION,
    GENTLE,
    INERTIAL,
    LENGTHS,
    LONG,
    SPEED,
    Case,
    Score,
)
from benchmarks.estimator_scores import rms, work
from benchmarks.results import table, write_section
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.loop.consistency import band

COMMAND = "python -m benchmarks.estimators"
KS = "kinematic_solver"
EKF = "baselines.ks_ekf:KsEkf"
DYNAMIC = "baselines.dynamic_estimator:DynamicEstimator"
LOOSE, TIGHT = f"{EKF} coupling=loose", f"{EKF} coupling=tight"
# As wrong as the robot really is where only encoders are biased, and nothing else.
MATCHED_TIGHT = f"{TIGHT} length_walk=0 center_of_mass_prior=0"
MATCHED_LOOSE = f"{LOOSE} length_walk=0 center_of_mass_prior=0"
MATCHED_DYNAMIC = (
    f"{DYNAMIC} mass=0 center_of_mass=0 length_bias=5e-3 length_bias_walk=0 wind_force=1"
)

ALL = ((KS, LENGTHS), (DYNAMIC, LENGTHS), (LOOSE, INERTIAL), (TIGHT, INERTIAL), (DYNAMIC, INERTIAL))
MATCHED = (
    (MATCHED_DYNAMIC, LENGTHS), (MATCHED_LOOSE, INERTIAL), (MATCHED_TIGHT, INERTIAL),
    (MATCHED_DYNAMIC, INERTIAL),
)  # fmt: skip
HALF = 0.5  # of the error of KS
RECOVERED = 1.5  # times the error without a fault


@dataclass(frozen=True, kw_only=True)
class Part:
    """A part of the benchmark.

    Attributes:
        title: Of its section.
        perturbation: Condition of the plant.
        kinds: Of runs.
        listeners: Estimators and their suites.
        body: Makes the section from scores and robots.
    """

    title: str
    perturbation: str
    kinds: tuple[str, ...]
    listeners: tuple[tuple[str, str], ...]
    body: Callable[[list[Score], Sequence[str]], str]


def short(estimator: str) -> str:
    """Name in a table."""
    name, *settings = estimator.split()
    coupling = [s.removeprefix("coupling=") for s in settings if s.startswith("coupling=")]
    return " ".join([name.split(":")[0].split(".")[-1], *coupling])


def chosen(scores: list[Score], robot: str, listener: tuple[str, str]) -> list[Score]:
    """Scores of an estimator on one robot, by seed."""
    return [s for s in scores if (s.case.robot, s.estimator, s.suite) == (robot, *listener)]


def listeners(scores: list[Score]) -> list[tuple[str, str]]:
    """All estimators and their suites."""
    return list(dict.fromkeys((s.estimator, s.suite) for s in scores))


def verdict(good: bool) -> str:
    """Of a bar."""
    return "passed" if good else "**missed**"


def consistency(values: Sequence[float | None], dof: int) -> str:
    """Mean of NEES over runs, with the band of as many independent samples."""
    known = [v for v in values if v is not None]
    if not known:
        return "-"
    low, high = band(dof, len(known))
    return f"{np.mean(known):.2f} ({low:.2f}-{high:.2f})"


def accuracy(scores: list[Score], robots: Sequence[str]) -> str:
    """Errors, consistency under mismatch, and time on the swaying moves."""
    rows, bars = [], []
    for robot in robots:
        solver = chosen(scores, robot, ALL[0])
        for one in ALL:
            mine = chosen(scores, robot, one)
            error = [s.position for s in mine]
            rows.append(
                (
                    robot, one[1], short(one[0]), f"{1e3 * np.median(error):.1f}",
                    f"{1e3 * max(error):.1f}", f"{1e3 * rms(error):.1f}",
                    f"{ratio(mine, solver)[0]:.3f}", f"{1e3 * rms(s.rotation for s in mine):.1f}",
                    consistency([s.pose for s in mine], 6),
                    consistency([s.full for s in mine], 12),
                    f"{1e3 * np.median([s.time for s in mine]):.1f}",
                )
            )  # fmt: skip
            if one[0] != KS:
                share, each = ratio(mine, solver)
                bars.append(
                    (robot, f"{short(one[0])}, `{one[1]}`: error over that of KS", f"{HALF:g}",
                     f"{share:.3f}; {sum(each <= HALF)} of {len(each)} seeds",
                     verdict(share <= HALF))
                )  # fmt: skip
        tight, loose = (chosen(scores, robot, (name, INERTIAL)) for name in (TIGHT, LOOSE))
        share, each = ratio(tight, loose)
        bars.append(
            (robot, "ks_ekf: error of tight over loose", "below 1",
             f"{share:.3f}; {sum(each < 1.0)} of {len(each)} seeds", verdict(share < 1.0))
        )  # fmt: skip
    header = (
        "robot", "suite", "estimator", "position RMSE, median of seeds [mm]", "worst seed [mm]",
        "all seeds [mm]", "over KS", "rotation RMSE [mrad]", "NEES of the pose (95 % band)",
        "NEES of pose and twist (95 % band)", "CPU time an update [ms]",
    )  # fmt: skip
    return (
        f"Minimum-snap moves a line, up to {SPEED:g} m/s and {ACCELERATION:g} m/s^2, cables of "
        "particles, plant `nominal-1`. KS is in the loop; all hear the same measurements. NEES is "
        "reported under mismatch: mass, exit points, stiffness, wind are not what the estimators "
        f"think.\n\n{table(HEADER, bars)}\n\n{table(header, rows)}"
    )


def ratio(mine: list[Score], other: list[Score]) -> tuple[float, Array]:
    """Position error over that of another estimator: all seeds that both have, and each."""
    known = {s.case: s.position for s in other}
    pairs = np.array([(s.position, known[s.case]) for s in mine if s.case in known])
    return rms(pairs[:, 0]) / rms(pairs[:, 1]), pairs[:, 0] / pairs[:, 1]


HEADER = ("robot", "bar", "required", "measured", "")


def nees(scores: list[Score], robots: Sequence[str]) -> str:
    """Consistency with the model that the plant has."""
    rows = []
    for robot in robots:
        for one in listeners(scores):
            mine = chosen(scores, robot, one)
            full = [s.full for s in mine if s.full is not None]
            low, high = band(12, len(full))
            rows.append(
                (
                    robot, one[1], short(one[0]), f"{1e3 * rms(s.position for s in mine):.1f}",
                    consistency([s.pose for s in mine], 6), f"{np.median(full):.2f}",
                    f"{low:.2f}-{high:.2f}", f"{np.mean(full):.2f}",
                    verdict(low <= float(np.mean(full)) <= high),
                )
            )  # fmt: skip
    header = (
        "robot", "suite", "estimator", "position RMSE [mm]", "NEES of the pose (95 % band)",
        "NEES of pose and twist, median run", "required (95 % band)", "measured", "",
    )  # fmt: skip
    return (
        "The same moves and wind; the plant is the model (`none`), but for encoder biases, which "
        "the settings know to be constant, as they know mass and centre of mass. Errors of a run "
        "go together, since biases are constant, so the bands are those of one sample a run.\n\n"
        + table(header, rows)
    )


def recovery(scores: list[Score], robots: Sequence[str]) -> str:
    """How estimators come back from faults."""
    rows = []
    for robot in robots:
        for one in listeners(scores):
            mine = chosen(scores, robot, one)
            for fault in mine[0].faults if mine else ():
                after = [s.faults[fault][0] for s in mine]
                same = [s.faults[fault][1] for s in mine]
                share = [a / s.position for a, s in zip(after, mine, strict=True)]
                apart = [a / b for a, b in zip(after, same, strict=True)]
                rows.append(
                    (
                        robot, short(one[0]), fault,
                        f"{1e3 * np.median([s.position for s in mine]):.1f}",
                        f"{1e3 * np.median(same):.1f}", f"{1e3 * np.median(after):.1f}",
                        f"{np.median(apart):.2f}, {max(apart):.2f}",
                        f"{np.median(share):.2f}, {max(share):.2f}",
                        verdict(max(share) <= RECOVERED),
                    )
                )  # fmt: skip
    header = (
        "robot", "estimator", "fault", "without it, whole run [mm]",
        "without it, 5 to 10 s after it would end [mm]", "5 to 10 s after it [mm]",
        "over the same time without it: median, worst seed",
        f"over the whole run without it, required {RECOVERED:g}: median, worst seed", "worst",
    )  # fmt: skip
    return (
        f"Suite `lengths+imu`, plant `nominal-1`, stop and go for {LONG:g} s at {GENTLE:g} m/s^2. "
        "Position errors, medians of seeds.\n\n" + table(header, rows)
    )


def workspace(scores: list[Score], robots: Sequence[str]) -> str:
    """Along the faces of the workspace box against its middle."""
    rows = []
    for robot in robots:
        for one in listeners(scores):
            mine = chosen(scores, robot, one)
            both = [
                rms(s.position for s in mine if s.case.kind == kind) for kind in ("centre", "edge")
            ]
            worst = max(s.position for s in mine if s.case.kind == "edge")
            rows.append(
                (robot, one[1], short(one[0]), *(f"{1e3 * e:.1f}" for e in both),
                 f"{both[1] / both[0]:.2f}", f"{1e3 * worst:.1f}")
            )  # fmt: skip
    header = (
        "robot", "suite", "estimator", "centre [mm]", "outer 10 % [mm]", "ratio",
        "outer 10 %, worst seed [mm]",
    )  # fmt: skip
    where = "Moves within the middle half of the workspace box, and along a face of it"
    said = f"{where}, {GENTLE:g} m/s^2, plant `nominal-1`; position RMSE. Reported, without a bar."
    return f"{said}\n\n{table(header, rows)}"


PARTS = {
    "accuracy": Part(title="Estimators in sway", perturbation="nominal-1", kinds=("sway",),
                     listeners=ALL, body=accuracy),
    "nees": Part(title="Estimators: consistency with the matched model", perturbation="none",
                 kinds=("sway",), listeners=MATCHED, body=nees),
    "faults": Part(title="Estimators: faults", perturbation="nominal-1", kinds=("long",),
                   listeners=ALL[2:], body=recovery),
    "edge": Part(title="Estimators: edge of the workspace", perturbation="nominal-1",
                 kinds=("centre", "edge"), listeners=ALL, body=workspace),
}  # fmt: skip


def measure(
    part: Part, robots: Sequence[str], seeds: int, processes: int, folder: Path | None
) -> str:
    """All runs of a part, and its section."""
    todo = [
        Case(robot=robot, perturbation=part.perturbation, seed=seed, kind=kind)
        for seed in range(seeds) for kind in part.kinds for robot in robots
    ]  # fmt: skip
    scores: list[Score] = []
    left_out = 0
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(processes, mp_context=spawn) as pool:
        for case, found in zip(
            todo, pool.map(partial(work, folder, part.listeners), todo), strict=True
        ):
            scores += found
            left_out += not found
            said = " ".join(f"{short(s.estimator)} {1e3 * s.position:.1f}" for s in found)
            print(case.name, said, flush=True)
    return part.body(scores, robots) + (
        f"\n\n{seeds} seeds of each; left out, as their path leaves what the cables can hold: "
        f"{left_out} of {len(todo)} runs."
    )


def main() -> None:
    """Measure and write the sections."""
    parser = argparse.ArgumentParser(prog=COMMAND)
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=list(PARTS))
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--robots", nargs="+", default=["carosac", "scampi"])
    parser.add_argument("--without", nargs="+", default=[], help="part of an estimator's name")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--keep", type=Path, help="folder of runs and scores, used again")
    parser.add_argument("--print-only", action="store_true", help="leave RESULTS.md as it is")
    asked = parser.parse_args()
    for name in asked.parts:
        part, without = PARTS[name], asked.without
        heard_by = tuple(x for x in part.listeners if not any(w in x[0] for w in without))
        part = replace(part, listeners=heard_by)
        body = measure(part, asked.robots, asked.seeds, asked.processes, asked.keep)
        print(body, flush=True)
        if not asked.print_only:
            command = f"{COMMAND} --parts {name} --seeds {asked.seeds}"
            command += f" --without {' '.join(without)}" if without else ""
            write_section(f"estimators:{name}", PARTS[name].title, command, body)


if __name__ == "__main__":
    main()
