"""The network that learned from MPC against MPC: tracking, slack, hand-overs and time.

Run by hand: ``python -m benchmarks.approximate_mpc [--seeds N] [--robots NAME ...]
[--networks FILE ...]``; two processes. The same plants, paths and estimator as of the drives in
`benchmarks.learning`; ratios are of one plant and path each. Beside the bundled networks, of seed
0, those of ``benchmarks/plans`` are driven, of the same training with other seeds, and the CPU time
of all trainings is told from their tables of rounds. Runs are kept under
``benchmarks/approximate_mpc.parts`` by the content of the network, so that a run goes on where
another one ended; remove the folder where other code has changed.
"""

from __future__ import annotations

import argparse
import csv
import hashlib
import json
import multiprocessing
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.controllers import MOVES, SMOOTH, Task, score
from benchmarks.results import table, write_section
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.files import replacing
from learned.approximate_mpc.networks import BUNDLED, find_network
from learned.approximate_mpc.plan_network import PlanNetwork

KEPT = Path(__file__).parent / "approximate_mpc.parts"
OTHER_SEEDS = Path(__file__).parent / "plans"
TITLE, CONTROLLER = "Approximate MPC", "approximate_mpc"
TIMED_DRIVES = 7  # of each controller, on one plant and path
PATHS = (*MOVES, SMOOTH)
HEADER = (  # of `rows_of`
    "robot", "network", "path", "tracking / sway [mm]", "of MPC", "ratio, 95 % bound",
    "slack, of MPC [% of the time]", "handed over [% of the cycles]", "failed, of MPC",
)  # fmt: skip
CLOCKS = ("robot", "network [ms]", "95 % [ms]", "MPC [ms]", "95 % of MPC [ms]", "ratio")
NUMBERS = ("rmse", "sway", "slack", "believed", "fallbacks", "cycles", "limited")
SIGMAS_95 = 1.96


def drive(task: Task) -> dict[str, Any]:
    """Score a run, unless that was kept."""
    what = "mpc" if task.policy is None else _content(task.policy)
    path = KEPT / f"{task.robot}-{what}-{PATHS.index(task.path)}-{task.seed}.json"
    if path.is_file():
        return dict(json.loads(path.read_text(encoding="utf-8")))
    row = score(task)
    kept: dict[str, Any] = (
        {"failed": row["failed"]}
        if "failed" in row
        else {name: float(row[name]) for name in NUMBERS}
    )
    KEPT.mkdir(exist_ok=True)
    with replacing(path) as temporary:
        temporary.write_text(json.dumps(kept), encoding="utf-8")
    return kept


def _content(policy: str) -> str:
    """Return a short name for the content of a network's file."""
    return hashlib.sha256(find_network(policy).read_bytes()).hexdigest()[:12]


def latencies(robot: str) -> Array:
    """Return the CPU time of a command [s], of the network and of MPC, shape (2, 2).

    Median of all commands, and what one of twenty exceeds. Drives of both take turns: where a core
    runs slower, a drive takes half as long again.
    """
    tasks = [
        Task(robot=robot, controller=name, path=PATHS[0], seed=0) for name in (CONTROLLER, "mpc")
    ]
    times = [
        [np.quantile(score(task)["latency"], [0.5, 0.95]) for task in tasks]
        for _ in range(TIMED_DRIVES)
    ]
    return np.asarray(np.median(times, axis=0))


def training_time(path: Path) -> float:
    """Return the CPU time of a training, drives and regressions, by its table of rounds [s].

    Raises:
        InvalidField: There is no table with such a column.
    """
    try:
        with path.open(encoding="utf-8", newline="") as file:
            times = [float(row["cpu_s"]) for row in csv.DictReader(file)]
    except (OSError, KeyError, TypeError, ValueError) as error:
        allowed = "the table of rounds of a training, with cpu_s"
        raise InvalidField("training", path, allowed) from error
    if not times:
        raise InvalidField("training", f"{path} without rounds", "at least one")
    return sum(times)


def table_of(network: str) -> Path:
    """Return where the table of rounds of a network is: beside it."""
    return find_network(network).with_suffix(".csv")


def check_alike(networks: Sequence[str]) -> None:
    """Refuse networks of one robot that differ in more, or less, than the seed of their training.

    Raises:
        InvalidField: Some do, or there are no settings beside one.
    """
    first: dict[str, tuple[str, Any]] = {}
    seeds = set()
    for network in networks:
        path = find_network(network).with_suffix(".json")
        try:
            settings = json.loads(path.read_text(encoding="utf-8"))
            robot, seed = settings["robot"]["name"], settings.pop("seed")
        except (OSError, KeyError, TypeError, ValueError) as error:
            allowed = "the settings of the network's training beside it"
            raise InvalidField("training", path, allowed) from error
        other, same = first.setdefault(robot, (network, settings))
        names = [k for k in {*settings, *same} if settings.get(k) != same.get(k)]
        if names:
            allowed = f"one trained as {other}, but for the seed"
            raise InvalidField("network", f"{network} with another {' and '.join(names)}", allowed)
        if (robot, seed) in seeds:
            raise InvalidField("network", f"{network} of seed {seed} again", "another seed")
        seeds.add((robot, seed))


def rows_of(robot: str, label: str, mine: Sequence[Any], theirs: Sequence[Any]) -> list[list[str]]:
    """Return a row for each path: a network's drives beside MPC's on the same plants."""
    rows = []
    for k, path in enumerate(PATHS):
        both = [
            (a, b) for a, b in zip(mine[k], theirs[k], strict=True)
            if "failed" not in a and "failed" not in b
        ]  # fmt: skip
        failed = [sum("failed" in one for one in side[k]) for side in (mine, theirs)]
        logs = np.log([a["rmse"] / b["rmse"] for a, b in both])
        spread = SIGMAS_95 * logs.std(ddof=1) / np.sqrt(len(logs)) if len(logs) > 1 else np.nan
        values = [
            {name: np.array([one[name] for one in side]) for name in NUMBERS}
            for side in zip(*both, strict=True)
        ]
        rms = [[1e3 * np.sqrt((v[n] ** 2).mean()) for n in ("rmse", "sway")] for v in values]
        rows.append([
            robot, label, path,
            f"{rms[0][0]:.1f} / {rms[0][1]:.1f}", f"{rms[1][0]:.1f} / {rms[1][1]:.1f}",
            f"{np.exp(logs.mean()):.2f}, up to {np.exp(logs.mean() + spread):.2f}",
            f"{100 * values[0]['slack'].mean():.1f}, {100 * values[1]['slack'].mean():.1f}",
            f"{100 * values[0]['fallbacks'].sum() / values[0]['cycles'].sum():.2f}",
            f"{failed[0]}, {failed[1]} of {len(mine[k])}",
        ])  # fmt: skip
    return rows


def main() -> None:
    """Measure and write."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--seeds", type=int, default=15)
    parser.add_argument("--robots", nargs="+", default=["carosac", "scampi"])
    parser.add_argument("--networks", nargs="*", default=[], help="ONNX files; beside the bundled")
    parser.add_argument("--processes", type=int, default=2)
    asked = parser.parse_args()
    bundled = [BUNDLED[name] for name in asked.robots]
    seeds = bundled + [str(path) for path in sorted(OTHER_SEEDS.glob("*.onnx"))]
    check_alike(seeds)
    spent = {name: training_time(table_of(name)) for name in seeds}
    networks = seeds + asked.networks
    loaded = [(name, PlanNetwork.load(find_network(name)).description) for name in networks]
    every: dict[str, list[tuple[str, str]]] = {name: [] for name in asked.robots}
    for name, description in loaded:
        if description.robot.name in every:
            label = f"seed {description.seed}" if name in seeds else name
            every[description.robot.name].append((label, name))
    tasks = [
        Task(robot=robot, controller=CONTROLLER if policy else "mpc", path=path, seed=seed,
             policy=policy)
        for robot, those in every.items()
        for policy in [None, *(policy for _, policy in those)]
        for path in PATHS for seed in range(asked.seeds)
    ]  # fmt: skip
    context = multiprocessing.get_context("spawn")
    with context.Pool(asked.processes) as pool:
        done = iter(pool.map(drive, tasks, chunksize=1))
    times = {robot: latencies(robot) for robot in asked.robots}
    rows, trainings = [], []
    for robot, those in every.items():
        groups = [
            [[next(done) for _ in range(asked.seeds)] for _ in PATHS] for _ in range(len(those) + 1)
        ]
        for (label, _), mine in zip(those, groups[1:], strict=True):
            rows += rows_of(robot, label, mine, groups[0])
        trainings += [
            [robot, label, f"{spent[name] / 60.0:.1f}"]
            for label, name in those if name in spent
        ]  # fmt: skip
    clocks = [
        [
            robot,
            *(f"{1e3 * x:.3f}" for x in mine),
            *(f"{1e3 * x:.2f}" for x in theirs),
            f"{theirs[0] / mine[0]:.1f}",
        ]
        for robot, (mine, theirs) in times.items()
    ]
    text = [
        f"{asked.seeds} plants drawn from nominal-1, `dynamic_estimator` on lengths and IMU; "
        "bundled networks by the seed of their training, others by their file; ratios of tracking "
        "are means over pairs of runs on one plant and path, and the upper bound of the mean.",
        "", table(HEADER, rows), "",
        f"CPU time of a command in the loop, median and 95 %, medians of {TIMED_DRIVES} drives of "
        "each on one plant and path, by turns:",
        "", table(CLOCKS, clocks), "",
        "CPU time of trainings, drives and regressions, as their tables of rounds have it:",
        "", table(["robot", "network", "minutes"], trainings),
    ]  # fmt: skip
    write_section("approximate-mpc", TITLE, "python -m benchmarks.approximate_mpc", "\n".join(text))


if __name__ == "__main__":
    main()
