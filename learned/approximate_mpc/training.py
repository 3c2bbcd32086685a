"""Training of a network on what MPC answers: rounds of drives and of regression.

MPC drives in the first round; in each later one the network that has been trained so far does, and
MPC says what it would have done, so that the network learns where its own errors lead. A folder
holds every drive, the network of each round and a table of errors. A training that was killed goes
on from there; with the same code it ends as if it had not been.
"""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import numpy as np

from baselines.mpc.plan_times import settings_for
from baselines.mpc.settings import MpcSettings
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
from learned.approximate_mpc.perceptron import Perceptron
from learned.approximate_mpc.plan_inputs import input_units, usual_tension
from learned.approximate_mpc.plan_network import (
    PLAN_SCHEMA,
    PlanDescription,
    PlanNetwork,
    check_share,
    settings_record,
    write_plan_network,
)
from learned.approximate_mpc.rounds import (
    CountCallback,
    ProgressCallback,
    Regression,
    WriteCallback,
    begin,
    is_held_out,
    median_of_ended,
    regress,
    rms,
    train_rounds,
)
from learned.policy_file import record_of
from learned.policy_network import Layers

MARGIN = 2.0  # of an output of 1: times the largest change, or sag less stretch, that was met
# Of the unit of an error, the weight per cable or a tenth of the scale of sag less stretch: larger
# ones count linearly, so that the small changes that hold a platform still are learned as well as
# the large ones, which are harder to foresee.
HUBER = 0.002
SPREAD_MIN = 1e-3  # of an input, in its unit of `carosac`: what hardly varies is not blown up
TABLE_COLUMNS = (
    "round", "drives", "samples", "lost", "drive_error_m", "trained_error_N", "held_out_error_N",
    "cpu_s",
)  # fmt: skip


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

    drives: tuple[int, ...] = (25, 45, 60, 60)
    updates: tuple[int, ...] = (5000, 5000, 5000, 40000)
    batch: int = 512
    hidden: tuple[int, ...] = (192, 192, 128)
    rate: float = 2e-3
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
    begin(folder, {
        "robot": record_of(robot), "seed": seed, "training": asdict(chosen),
        "demonstrations": asdict(driven), "mpc": settings_record(teacher), "schema": PLAN_SCHEMA,
    })  # fmt: skip

    def fit(
        k: int, paths: list[Path], told: CountCallback
    ) -> tuple[dict[str, float], WriteCallback]:
        began = time.process_time()
        parts = [Demonstrations.load(each) for each in paths]
        last = parts[-chosen.drives[k] :]
        errors = [part.error for part in last]
        found = _fit(robot, teacher.stages, parts, chosen, k, seed, told)
        scores = found.scores | {
            "lost": float(np.sum(~np.isfinite(errors))), "drive_error_m": median_of_ended(errors),
        }  # fmt: skip
        description = PlanDescription(
            robot=robot, mpc=settings_record(teacher), tension_scale=found.tension_scale,
            excess_scale=found.excess_scale, seed=seed, commit=commit_of_code() or "",
            training={
                "drives": float(len(parts)), "samples": found.scores["samples"],
                "tension_share": chosen.tension_share,
            },
            scores=scores,
        )  # fmt: skip
        spent = sum(part.cpu_time for part in last) + time.process_time() - began
        return scores | {"cpu_s": spent}, partial(
            write_plan_network, layers=found.layers, description=description
        )

    return train_rounds(
        folder, chosen.drives,
        lambda _, network: partial(_drive, robot, driven, teacher, seed, network_file=network),
        fit, columns=TABLE_COLUMNS, drives="drives", workers=workers, report=report,
    )  # fmt: skip


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
        tension_scale: Change of tensions for an output of 1 [N].
        excess_scale: Sag less stretch for an output of 1 [m].
        scores: By name.
    """

    layers: Layers
    tension_scale: float
    excess_scale: float
    scores: dict[str, float]


def _fit(
    robot: Robot,
    stages: int,
    parts: list[Demonstrations],
    settings: DistillationSettings,
    number: int,
    seed: int,
    report: CountCallback,
) -> _Fit:
    """Fit a new network to all answers."""
    held = np.concatenate(
        [np.full(len(part.numbers), is_held_out(k)) for k, part in enumerate(parts)]
    )
    numbers = np.concatenate([part.numbers for part in parts]).astype(np.float64)
    tension = np.concatenate([part.tension for part in parts])
    excess = np.concatenate([part.excess for part in parts])
    if not len(numbers) or held.all():
        why = next((part.lost for part in parts if part.lost), "too few drives")
        raise CarosacError(f"distillation: MPC gave no answers that can be learned from ({why})")
    change = tension - usual_tension(robot, numbers)
    tension_scale, excess_scale = (MARGIN * float(np.abs(x).max()) for x in (change, excess))
    wanted = np.hstack([change / tension_scale, excess / excess_scale])
    unit = np.repeat([robot.weight / robot.n / tension_scale, 0.1], robot.n)
    layers = regress(
        numbers[~held], wanted[~held], unit, SPREAD_MIN * input_units(robot, stages),
        Regression(
            hidden=settings.hidden, updates=settings.updates[number], batch=settings.batch,
            rate=settings.rate, huber=HUBER, seed=1000 * seed + number,
        ),
        report,
    )  # fmt: skip
    off = tension_scale * (Perceptron(layers)(numbers) - wanted)[:, : robot.n]
    scores = {
        "samples": float(len(numbers)),
        "trained_error_N": rms(off[~held]),
        "held_out_error_N": rms(off[held]),
    }
    return _Fit(
        layers=layers, tension_scale=tension_scale, excess_scale=excess_scale, scores=scores
    )
