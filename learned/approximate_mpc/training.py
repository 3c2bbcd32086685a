"""Training of a network on what MPC answers: rounds of drives and of regression.

MPC drives in the first round; in each later one the network that has been trained so far does, and
MPC says what it would have done, so that the network learns where its own errors lead. A folder
holds every drive, the network of each round and a table of errors. A training that was killed goes
on from there; with the same code it ends as if it had not been.
"""

from __future__ import annotations

import json
import multiprocessing
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from baselines.mpc.plan_times import settings_for
from baselines.mpc.settings import MpcSettings
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import CarosacError, InvalidField
from carosac_toolkit.base.extras import require
from carosac_toolkit.base.files import replacing
from carosac_toolkit.base.numbers import check_whole
from carosac_toolkit.base.scaled import resolved
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.reports.page import commit_of_code
from carosac_toolkit.robot.robot import Robot
from learned.approximate_mpc.controller import check_cables
from learned.approximate_mpc.demonstrations import (
    Demonstrations,
    DemonstrationSettings,
    demonstrate,
)
from learned.approximate_mpc.plan_inputs import input_units
from learned.approximate_mpc.plan_network import (
    PlanDescription,
    PlanNetwork,
    check_share,
    settings_record,
    tension_range,
    write_plan_network,
)
from learned.policy_file import record_of
from learned.policy_network import Layers

SETTINGS_FILE, TABLE_FILE, NETWORK_FILE = "settings.json", "rounds.csv", "network.onnx"
EXCESS_MARGIN = 2.0  # times the largest sag less stretch that was met: of an output of 1
SPREAD_MIN = 1e-3  # of an input, in its unit of `carosac`: what hardly varies is not blown up
HELD_OUT_EVERY = 12  # one drive of so many is not trained on
TABLE_COLUMNS = (
    "round", "drives", "samples", "lost", "drive_error_m", "trained_error_N", "held_out_error_N"
)  # fmt: skip
ProgressCallback = Callable[[str, int, int], None]


@dataclass(frozen=True, kw_only=True)
class DistillationSettings:
    """Numbers of a training.

    Attributes:
        drives: Of each round.
        updates: Of the network after each round.
        batch: Samples of an update.
        hidden: Sizes of the hidden layers.
        rate: Learning rate at the start of a round; it falls to 0 by a cosine.
        tension_share: See `PlanFollower`; 1 sends tensions as they are planned.
    """

    drives: tuple[int, ...] = (80, 100, 100, 120)
    updates: tuple[int, ...] = (8000, 8000, 8000, 40000)
    batch: int = 512
    hidden: tuple[int, ...] = (256, 256)
    rate: float = 1e-3
    tension_share: float = 1.0

    def __post_init__(self) -> None:
        """Refuse numbers that make no sense."""
        if len(self.drives) != len(self.updates) or not self.drives:
            got = f"{len(self.drives)} and {len(self.updates)}"
            raise InvalidField("drives and updates", got, "as many of both, at least one")
        for name in ("drives", "updates", "hidden"):
            for number in getattr(self, name):
                check_whole(name, number, 1)
        check_whole("batch", self.batch, 1)
        if not 0.0 < self.rate < 1.0:
            raise InvalidField("rate", self.rate, "0 < rate < 1")
        check_share("tension_share", self.tension_share)


def distill(
    robot: Robot,
    folder: Path,
    *,
    seed: int = 0,
    settings: DistillationSettings | None = None,
    demonstrations: DemonstrationSettings | None = None,
    mpc: MpcSettings | None = None,
    workers: int = 1,
    report: ProgressCallback = lambda what, done, of: None,
) -> Path:
    """Train a network for a robot.

    Args:
        robot: The nominal robot.
        folder: For all results; a training that is there goes on.
        seed: Of everything that is drawn.
        settings: None takes the defaults.
        demonstrations: None takes the defaults.
        mpc: Of the teacher; None takes the defaults.
        workers: Processes that drive.
        report: Called with what is being done, how much of it is done, and of how much.

    Returns:
        The ONNX file.

    Raises:
        InvalidField: The folder holds another training.
        MissingExtra: torch or onnx is not installed.
    """
    require("training", "onnx", "torch")
    chosen = settings or DistillationSettings()
    check_whole("workers", workers, 1)
    check_cables(robot)
    driven = resolved(demonstrations or DemonstrationSettings(), Scales(robot).ratios)
    teacher, _ = settings_for(robot, mpc or MpcSettings())
    _begin(folder, robot, seed, chosen, driven, teacher)
    path: Path | None = None
    parts: list[Demonstrations] = []
    for k, count in enumerate(chosen.drives):
        first = sum(chosen.drives[:k])
        parts += _drives(
            robot, driven, teacher, seed, range(first, first + count), path, folder, workers,
            partial(report, f"round {k + 1} of {len(chosen.drives)}: drives"),
        )  # fmt: skip
        path = folder / f"round-{k + 1}.onnx"
        if not path.is_file():
            fit = _fit(
                robot, teacher.stages, parts, chosen, k, seed,
                partial(report, f"round {k + 1} of {len(chosen.drives)}: updates"),
            )  # fmt: skip
            errors = np.array([part.error for part in parts[first:]])
            ended = errors[np.isfinite(errors)]
            scores = fit.scores | {
                "lost": float(len(errors) - len(ended)),
                "drive_error_m": float(np.median(ended)) if len(ended) else float("nan"),
            }
            _note(folder, k + 1, len(parts), scores)
            write_plan_network(
                path, fit.layers,
                PlanDescription(
                    robot=robot, mpc=settings_record(teacher), excess_scale=fit.excess_scale,
                    seed=seed, commit=commit_of_code() or "",
                    training={
                        "drives": float(len(parts)), "samples": fit.scores["samples"],
                        "tension_share": chosen.tension_share,
                    },
                    scores=scores,
                ),
            )  # fmt: skip
    assert path is not None, "there is at least one round"
    with replacing(folder / NETWORK_FILE) as temporary:
        temporary.write_bytes(path.read_bytes())
    return folder / NETWORK_FILE


def _begin(
    folder: Path,
    robot: Robot,
    seed: int,
    settings: DistillationSettings,
    demonstrations: DemonstrationSettings,
    mpc: MpcSettings,
) -> None:
    """Write what is trained, or make sure that the folder's training is this one."""
    folder.mkdir(parents=True, exist_ok=True)
    record = {
        "robot": record_of(robot), "seed": seed, "training": asdict(settings),
        "demonstrations": asdict(demonstrations), "mpc": settings_record(mpc),
    }  # fmt: skip
    text = json.dumps(record, indent=1, sort_keys=True) + "\n"
    path = folder / SETTINGS_FILE
    if path.is_file():
        if path.read_text(encoding="utf-8") != text:
            allowed = "a training of this robot, seed and settings, or a new folder"
            raise InvalidField("folder", f"{folder} with another training", allowed)
        return
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def _drives(
    robot: Robot,
    settings: DemonstrationSettings,
    mpc: MpcSettings,
    seed: int,
    numbers: range,
    network_file: Path | None,
    folder: Path,
    workers: int,
    report: Callable[[int, int], None],
) -> list[Demonstrations]:
    """Return drives by their numbers; those in the folder are read."""
    paths = {k: folder / f"drive-{k:04d}.npz" for k in numbers}
    missing = [k for k, path in paths.items() if not path.is_file()]
    report(len(numbers) - len(missing), len(numbers))
    job = partial(_drive, robot, settings, mpc, seed, network_file=network_file)
    if workers == 1:
        for done, k in enumerate(missing, len(numbers) - len(missing) + 1):
            job(k, paths[k])
            report(done, len(numbers))
    elif missing:
        context = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(workers, mp_context=context) as pool:
            done = len(numbers) - len(missing)
            for _ in pool.map(job, missing, [paths[k] for k in missing]):
                done += 1
                report(done, len(numbers))
    return [Demonstrations.load(path) for path in paths.values()]


def _drive(
    robot: Robot,
    settings: DemonstrationSettings,
    mpc: MpcSettings,
    seed: int,
    number: int,
    path: Path,
    *,
    network_file: Path | None,
) -> None:
    """Drive once and keep what MPC answered."""
    network = None if network_file is None else PlanNetwork.load(network_file)
    demonstrations = demonstrate(robot, settings, mpc, (seed, number), network)
    with replacing(path) as temporary:
        demonstrations.save(temporary)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Fit:
    """A network that was fitted.

    Attributes:
        layers: Weights and biases.
        excess_scale: Sag less stretch for an output of 1 [m].
        scores: By name.
    """

    layers: Layers
    excess_scale: float
    scores: dict[str, float]


def _fit(
    robot: Robot,
    stages: int,
    parts: list[Demonstrations],
    settings: DistillationSettings,
    number: int,
    seed: int,
    report: Callable[[int, int], None],
) -> _Fit:
    """Fit a new network to all answers."""
    import torch

    torch.manual_seed(1000 * seed + number)
    torch.set_num_threads(1)
    held = np.concatenate([
        np.full(len(part.numbers), k % HELD_OUT_EVERY == HELD_OUT_EVERY - 1)
        for k, part in enumerate(parts)
    ])  # fmt: skip
    numbers = np.concatenate([part.numbers for part in parts]).astype(np.float64)
    tension = np.concatenate([part.tension for part in parts])
    excess = np.concatenate([part.excess for part in parts])
    if not len(numbers) or held.all():
        why = next((part.lost for part in parts if part.lost), "too few drives")
        raise CarosacError(f"distillation: MPC gave no answers that can be learned from ({why})")
    excess_scale = EXCESS_MARGIN * float(np.abs(excess).max())
    middle, half = tension_range(robot)
    wanted = np.hstack([(tension - middle) / half, excess / excess_scale])
    unit = np.concatenate([robot.weight / robot.n / half, np.full(robot.n, 0.1)])
    least = SPREAD_MIN * input_units(robot, stages)
    mean, spread = numbers.mean(axis=0), np.maximum(numbers.std(axis=0), least)
    seen = torch.tensor((numbers - mean) / spread, dtype=torch.float32)
    goal = torch.tensor(wanted, dtype=torch.float32)
    scale = torch.tensor(unit, dtype=torch.float32)
    sizes = [seen.shape[1], *settings.hidden, goal.shape[1]]
    modules: list[Any] = []
    for a, b in pairwise(sizes):
        modules += [torch.nn.Linear(a, b), torch.nn.SiLU()]
    network = torch.nn.Sequential(*modules[:-1], torch.nn.Tanh())
    linear = [module for module in network if isinstance(module, torch.nn.Linear)]
    rows = torch.nonzero(torch.tensor(~held))[:, 0]
    optimiser = torch.optim.Adam(network.parameters(), settings.rate)
    updates = settings.updates[number]
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, updates)
    for k in range(updates):
        batch = rows[torch.randint(len(rows), (settings.batch,))]
        off = (network(seen[batch]) - goal[batch]) / scale
        loss = torch.nn.functional.smooth_l1_loss(off, torch.zeros_like(off), beta=0.1)
        optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        optimiser.step()
        schedule.step()
        if k % 500 == 0:
            report(k, updates)
    with torch.no_grad():
        off = ((network(seen) - goal)[:, : robot.n] * torch.tensor(half)).numpy()
    layers = [(x.weight.detach().numpy().copy(), x.bias.detach().numpy().copy()) for x in linear]
    first = layers[0][0] / spread.astype(np.float32)
    layers[0] = (first, layers[0][1] - first @ mean.astype(np.float32))
    scores = {
        "samples": float(len(numbers)),
        "trained_error_N": _rms(off[~held]),
        "held_out_error_N": _rms(off[held]) if held.any() else float("nan"),
    }
    return _Fit(layers=layers, excess_scale=excess_scale, scores=scores)


def _note(folder: Path, number: int, drives: int, scores: dict[str, float]) -> None:
    """Add a row to the table of rounds."""
    path = folder / TABLE_FILE
    rows = path.read_text(encoding="utf-8").splitlines() if path.is_file() else []
    rows = [",".join(TABLE_COLUMNS), *rows[1:number]]
    values = {"round": number, "drives": drives} | scores
    rows.append(",".join(f"{values[name]:.6g}" for name in TABLE_COLUMNS))
    with replacing(path) as temporary:
        temporary.write_text("\n".join(rows) + "\n", encoding="utf-8")


def _rms(values: Array) -> float:
    return float(np.sqrt((values**2).mean()))
