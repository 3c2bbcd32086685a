"""Policies beside model predictive control, input shaping and inverse kinematics, on same moves."""

from __future__ import annotations

import multiprocessing
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.controllers import (
    CALM,
    END,
    ESTIMATOR,
    MAIN,
    MOVES,
    SMOOTH,
    SUITE,
    Task,
    ended,
    mean,
    score,
)
from benchmarks.results import table
from carosac_toolkit.base.errors import CarosacError
from carosac_toolkit.loop import plugins
from learned.policy_file import Policy, PolicyDescription

TITLE = "Learned control beside model predictive control and input shaping"
BASELINES = ("kinematic_solver", "input_shaping", "mpc")
TD3 = ("td3", "learned.policy_controller:PolicyController")  # as installed, or by its class
OUTER = "fast, outer 10 %"
PATHS = (*MOVES, SMOOTH)
UNTRAINED = 1000  # environment steps up to which a policy of `residual` has not learned yet
LIMIT_RATIO = 0.6  # tracking, of the kinematic solver
LIMIT_LATENCY = 0.2  # [ms]
MS, MM = 1e3, 1e3

Row = dict[str, Any]


@dataclass(frozen=True, kw_only=True)
class Entry:
    """A controller in the table.

    Attributes:
        name: For the table.
        robot: Which it drives.
        controller: For `Task`.
        policy: File of a policy, or None.
    """

    name: str
    robot: str
    controller: str
    policy: str | None = None

    def task(self, path: str, seed: int) -> Task:
        """A run of it."""
        return Task(robot=self.robot, controller=self.controller, path=path, seed=seed,
                    policy=self.policy)  # fmt: skip


def td3() -> str:
    """How the registry finds the policies' controller."""
    try:
        plugins.load("controllers", TD3[0])
    except CarosacError:
        return TD3[1]
    return TD3[0]


def entries(policies: Sequence[Path], robots: Sequence[str]) -> list[Entry]:
    """All controllers: the baselines, and each policy on its own robot."""
    found = [Entry(name=name, robot=robot, controller=name)
             for robot in robots for name in BASELINES]  # fmt: skip
    for path in policies:
        about = Policy.load(path).description
        if about.robot.name not in robots:
            print(f"left out: {path}: for {about.robot.name}", flush=True)
            continue
        found.append(Entry(name=named(about), robot=about.robot.name,
                           controller=td3(), policy=str(path)))  # fmt: skip
    return sorted(found, key=lambda e: robots.index(e.robot))


def named(about: PolicyDescription) -> str:
    """Preset, seed and steps, or that nothing was learned."""
    learned = f"{about.steps} steps" if about.steps > UNTRAINED else "untrained"
    return f"td3 ({about.preset}, seed {about.seed}, {learned})"


def drive(policies: Sequence[Path], seeds: int, robots: Sequence[str], processes: int) -> str:
    """Run all and make the section."""
    chosen = entries(policies, robots)
    runs = [(e, path, seed) for e in chosen for path in PATHS for seed in range(seeds)]
    rows: dict[Entry, list[Row]] = {entry: [] for entry in chosen}
    with multiprocessing.get_context("spawn").Pool(processes) as pool:
        found = pool.imap(score, [e.task(path, seed) for e, path, seed in runs])
        for (entry, path, seed), row in zip(runs, found, strict=True):
            rows[entry].append(row)
            said = f"{MM * row['rmse']:.1f} mm" if "rmse" in row else row["failed"]
            print(f"{entry.robot} {entry.name}, {path}, seed {seed}: {said}", flush=True)
    return (
        f"Driver `simulator`, cables of particles, `nominal-1` with its wind, suite `{SUITE}`, "
        f"estimator `{ESTIMATOR.split(':')[-1]}`, {seeds} seeds of each path, the same ones for "
        "all. Tracking RMSE, root mean squares over the seeds on which no controller of the robot "
        "failed, so all are of the same plants; sway, its residual from "
        f"{CALM:g} to {END:g} s after the move. Latency is the CPU time of the controller alone on "
        "one core, all runs together; `mpc` was compiled where a compiler is there.\n\n"
        f"{comparison(rows)}\n\n{bars(rows)}{ended([r for group in rows.values() for r in group])}"
    )


def on(rows: Sequence[Row], path: str) -> list[Row]:
    """Those of a path that ended well."""
    return [r for r in rows if r["task"].path == path and "rmse" in r]


def together(rows: dict[Entry, list[Row]], robot: str, path: str) -> set[int]:
    """Seeds of a path on which all controllers of a robot ended well."""
    groups = [{r["task"].seed for r in on(g, path)} for e, g in rows.items() if e.robot == robot]
    return set.intersection(*groups)


def latency(rows: Sequence[Row]) -> tuple[float, float]:
    """Median and 95th percentile [ms]."""
    times = [x for r in rows if "rmse" in r for x in r["latency"]]
    if not times:
        return float("nan"), float("nan")
    return MS * float(np.median(times)), MS * float(np.quantile(times, 0.95))


def fallen(rows: Sequence[Row]) -> float:
    """Share of the cycles that a fallback commanded [%]."""
    ran = [r for r in rows if "rmse" in r]
    cycles = float(sum(r["cycles"] for r in ran))
    return 100.0 * float(sum(r["fallbacks"] for r in ran)) / max(1.0, cycles)


def comparison(rows: dict[Entry, list[Row]]) -> str:
    """Who wins where."""
    lines = []
    for entry, all_mine in rows.items():
        shared = {path: together(rows, entry.robot, path) for path in PATHS}
        mine = [r for r in all_mine if r["task"].seed in shared[r["task"].path]]
        both = [[MM * mean(on(mine, path), key) for path in PATHS] for key in ("rmse", "sway")]
        median, slowest = latency(mine)
        lines.append((
            entry.robot, entry.name,
            *(f"{a:.1f} / {b:.1f}" for a, b in zip(*both, strict=True)),
            f"{both[0][PATHS.index(OUTER)] / both[0][PATHS.index(MAIN)]:.2f}",
            f"{MM * mean([r for p in PATHS for r in on(mine, p)], 'believed'):.1f}",
            f"{100 * np.mean([r['slack'] for p in PATHS for r in on(mine, p)] or [np.nan]):.2f}",
            f"{median:.3f}", f"{slowest:.3f}",
            " / ".join(str(len(shared[path])) for path in PATHS),
            str(sum("failed" in r for r in all_mine)),
            f"{fallen(all_mine):.2f}",
        ))  # fmt: skip
    header = (
        "robot", "controller", *(f"{path}: tracking / sway [mm]" for path in PATHS),
        "outer 10 % over centre", "error of the estimator [mm]", "time with a slack cable [%]",
        "latency, median [ms]", "95 % [ms]", "plants counted", "failed runs",
        "cycles of a fallback, all runs [%]",
    )  # fmt: skip
    return table(header, lines)


def bars(rows: dict[Entry, list[Row]]) -> str:
    """Each policy against the kinematic solver on the same robot, runs that both ended."""
    lines = []
    for entry, mine in rows.items():
        if entry.policy is None:
            continue
        base = next(e for e in rows if (e.robot, e.name) == (entry.robot, "kinematic_solver"))
        ratios = []
        for path in PATHS:
            pair = [{r["task"].seed: r for r in on(group, path)} for group in (mine, rows[base])]
            same = sorted(set(pair[0]) & set(pair[1]))
            a, b = (mean([group[seed] for seed in same], "rmse") for group in pair)
            ratios.append(a / b)
        median, _ = latency(mine)
        lines.append((
            entry.robot, entry.name, *(f"{x:.2f}" for x in ratios),
            "passed" if max(ratios) <= LIMIT_RATIO else "**missed**", f"{median:.3f}",
            "passed" if median < LIMIT_LATENCY else "**missed**",
            str(sum("failed" in r for r in mine)),
        ))  # fmt: skip
    header = ("robot", "policy", *(f"{path}: tracking over kinematic_solver" for path in PATHS),
              f"{LIMIT_RATIO:g} on each", "latency, median [ms]",
              f"{LIMIT_LATENCY:g} ms", "failed runs, not in the ratios")  # fmt: skip
    return table(header, lines) if lines else "No policy was given."
