"""Learned from scratch, distilled from MPC, and both, after nearly as much CPU time each.

From scratch: preset `residual`, trained behind sensors and estimator, along the minimum-snap paths
of the preset, on top of its feedforward. Distilled: the bundled network. Both: one that learned
from three rounds of drives instead of four, and was refined by reinforcement learning; it is driven
before that, too. What was trained for the committed table is in ``benchmarks/ways``.
"""

from __future__ import annotations

import json
import multiprocessing
from dataclasses import asdict
from pathlib import Path

import carosac_toolkit as ct
from benchmarks.approximate_mpc import (
    CONTROLLER,
    HEADER,
    PATHS,
    drive,
    rows_of,
    table_of,
    training_time,
)
from benchmarks.controllers import Task
from benchmarks.learning_drive import td3
from benchmarks.refinement import RefinementSettings, refine
from benchmarks.results import table
from learned.approximate_mpc.networks import BUNDLED
from learned.approximate_mpc.rounds import NETWORK_FILE, TABLE_FILE
from learned.approximate_mpc.training import DistillationSettings, distill
from learned.learning_curve import CURVE_FILE, read_curve
from learned.training import train
from learned.training_study import TrainingRun

TITLE = "Learned from scratch, distilled, and both"
PRESET, STAGE, ESTIMATOR = "residual", "realtime", "dynamic_estimator"
STEPS = 260_000  # from scratch: they take as long as the other ways
SEED = 0
WHOLE = DistillationSettings()
SHORTER = DistillationSettings(
    drives=WHOLE.drives[:-1], updates=(*WHOLE.updates[:-2], WHOLE.updates[-1])
)
REFINED, SPENT = "refined.onnx", "spent.json"


def from_scratch(robot: str, folder: Path) -> tuple[Path, float]:
    """Train `residual` behind the estimator; return its policy and CPU time [s]."""
    run = TrainingRun(
        preset=PRESET, robot=robot, stages=(STAGE,), seed=SEED, steps=STEPS,
        fixed={"environment.moving.estimator": ESTIMATOR},
    )  # fmt: skip
    (job,) = run.jobs(ct.load_robot(robot), folder)
    policy = train(job, folder / STAGE)
    assert policy is not None
    return policy, read_curve(folder / STAGE / CURVE_FILE)[-1]["cpu_seconds"]


def both(robot: str, folder: Path, processes: int) -> tuple[Path, float, float]:
    """Distil and refine; return the network, and CPU time without refining it and in all [s]."""
    distill(ct.load_robot(robot), folder, seed=SEED, settings=SHORTER, workers=processes)
    network, refined, spent = (folder / name for name in (NETWORK_FILE, REFINED, SPENT))
    settings = RefinementSettings()
    if not (refined.is_file() and _is_of(spent, settings)):
        drives = [folder / f"drive-{k:04d}.npz" for k in range(sum(SHORTER.drives))]
        with multiprocessing.get_context("spawn").Pool(processes) as pool:
            took = refine(network, drives, refined, settings=settings, seed=SEED, pool=pool)
        spent.write_text(
            json.dumps({"cpu_s": took, "settings": asdict(settings)}), encoding="utf-8"
        )
    took = float(json.loads(spent.read_text(encoding="utf-8"))["cpu_s"])
    distilled = training_time(folder / TABLE_FILE)
    return refined, distilled, distilled + took


def _is_of(spent: Path, settings: RefinementSettings) -> bool:
    """Return whether a network was refined with these settings."""
    if not spent.is_file():
        return False
    return bool(json.loads(spent.read_text(encoding="utf-8")).get("settings") == asdict(settings))


def ways(folder: Path, seeds: int, robots: list[str], processes: int) -> str:
    """Train what is not trained yet, drive all, and make the section."""
    rows, trainings = [], []
    for robot in robots:
        place = folder / robot / "both"
        refined, before, in_all = both(robot, place, processes)
        found = {
            "from scratch": (td3(), *from_scratch(robot, folder / robot / "scratch")),
            "distilled": (
                CONTROLLER,
                Path(BUNDLED[robot]),
                training_time(table_of(BUNDLED[robot])),
            ),
            "both": (CONTROLLER, refined, in_all),
            "both, unrefined": (CONTROLLER, place / NETWORK_FILE, before),
        }
        tasks = [
            [Task(robot=robot, controller=name, path=path, seed=seed, policy=policy)
             for path in PATHS for seed in range(seeds)]
            for name, policy in [("mpc", None), *((x[0], str(x[1])) for x in found.values())]
        ]  # fmt: skip
        with multiprocessing.get_context("spawn").Pool(processes) as pool:
            groups = [iter(pool.map(drive, some, chunksize=1)) for some in tasks]
        mpc, *others = [[[next(one) for _ in range(seeds)] for _ in PATHS] for one in groups]
        for (way, (_, _, spent)), mine in zip(found.items(), others, strict=True):
            rows += rows_of(robot, way, mine, mpc)
            trainings.append([robot, way, f"{spent / 60.0:.1f}"])
    header = (HEADER[0], "way", *HEADER[2:])
    return (
        f"Seed {SEED} of each training; {seeds} plants drawn from nominal-1, `dynamic_estimator` "
        "on lengths and IMU, the drives of `benchmarks.approximate_mpc`.\n\n"
        f"{table(header, rows)}\n\nCPU time of the trainings:\n\n"
        f"{table(['robot', 'way', 'minutes'], trainings)}"
    )
