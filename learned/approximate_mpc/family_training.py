"""Training of one network for a family of robots: every drive is one of another robot.

MPC drives first, in its own prediction model, where a drive takes some seconds; then networks
do, there and in simulation, and MPC says what it would have done. See `training` for the rest.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np

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
from learned.approximate_mpc.demonstrations import DemonstrationSettings, demonstrate
from learned.approximate_mpc.family_network import (
    FAMILY_SCHEMA,
    FamilyDescription,
    FamilyNetwork,
    ranges_record,
    write_family_network,
)
from learned.approximate_mpc.family_numbers import CHANGE_MAX, COUNT, FamilyNumbers, mirror
from learned.approximate_mpc.family_robots import CABLES, draw_robot, family_settings, rests_record
from learned.approximate_mpc.model_world import answers
from learned.approximate_mpc.perceptron import Perceptron
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
from learned.policy_network import Layers

WORLDS = ("model", "simulator")
SPREAD_MIN = 1e-3  # of a number: what hardly varies is not blown up
IMAGES = ((), (0,), (1,), (0, 1))  # axes along which robots are mirrored
PATH_SPEED, PATH_ACCELERATION = 0.8, 0.6  # of a path, in the limits of winches, and at most
SPEED_MAX, ACCELERATION_MAX = 0.25, 0.35  # in sqrt(g L), and g
SPIN_SPREAD, MOMENT_SPREAD = 0.03, 0.01  # in sqrt(g / size of the platform), and its square
SIMULATED_TIME = 8.0  # of a path at most, in sqrt(L / g)
ANSWERS = 160  # of a simulated drive, about; each with those nearby
DRIVES = DemonstrationSettings(condition="nominal-2", nearby=1, elsewhere=0)
TABLE_COLUMNS = (
    "round", "robots", "samples", "lost", "drive_error", "trained_error", "held_out_error"
)  # fmt: skip
World = Literal["model", "simulator"]


@dataclass(frozen=True, kw_only=True)
class FamilySettings:
    """Numbers of a training.

    Attributes:
        robots: Of each round, each of which drives once.
        worlds: Where the robots of each round drive: in the model of MPC, or in simulation.
        updates: Of the network after each round.
        batch: Samples of an update.
        hidden: Sizes of the hidden layers.
        rate: Learning rate at the start of a round; it falls to 0 by a cosine.
        decay: Of weights, decoupled from the gradient.
    """

    robots: tuple[int, ...] = (700, 300, 150, 150)
    worlds: tuple[World, ...] = ("model", "model", "simulator", "simulator")
    updates: tuple[int, ...] = (8000, 8000, 8000, 40000)
    batch: int = 512
    hidden: tuple[int, ...] = (384, 384, 192)
    rate: float = 1e-3
    decay: float = 0.1

    def __post_init__(self) -> None:
        """Refuse numbers that make no sense."""
        sizes = [len(x) for x in (self.robots, self.worlds, self.updates)]
        if len(set(sizes)) != 1 or not self.robots:
            got = " and ".join(str(size) for size in sizes)
            raise InvalidField("robots, worlds and updates", got, "as many of each, one or more")
        for name in ("robots", "updates", "hidden"):
            for number in getattr(self, name):
                check_whole(name, number, 1)
        check_whole("batch", self.batch, 1)
        for world in self.worlds:
            if world not in WORLDS:
                raise InvalidField("worlds", repr(world), f"of {list(WORLDS)}")
        if not (0.0 < self.rate < 1.0 and 0.0 <= self.decay < 1.0):
            raise InvalidField("rate and decay", f"{self.rate}, {self.decay}", "0 to 1")


@dataclass(frozen=True, kw_only=True, eq=False)
class FamilyDrive:
    """What MPC answered about one robot.

    Attributes:
        numbers: That a network reads, shape (K, COUNT).
        told: What it is to tell, shape (K, 4).
        error: RMS distance from the reference in a simulated drive, over L; NaN: there is none.
        lost: Why the drive was given up, or nothing.
    """

    numbers: Array
    told: Array
    error: float
    lost: str

    def save(self, path: Path) -> None:
        """Write a file."""
        np.savez_compressed(
            path, numbers=self.numbers.astype(np.float32), told=self.told.astype(np.float32),
            error=self.error, lost=self.lost,
        )  # fmt: skip

    @classmethod
    def load(cls, path: Path) -> FamilyDrive:
        """Read a file that `save` wrote."""
        with np.load(path) as data:
            return cls(
                numbers=data["numbers"], told=data["told"], error=float(data["error"]),
                lost=str(data["lost"]),
            )  # fmt: skip


def distill_family(
    folder: Path,
    *,
    seed: int = 0,
    settings: FamilySettings | None = None,
    workers: int = 1,
    report: ProgressCallback = lambda what, done, of: None,
) -> Path:
    """Train a network for the family.

    Args:
        folder: For all results; a training that is there goes on.
        seed: Of everything that is drawn.
        settings: None takes the defaults.
        workers: Processes that drive.
        report: Called with what is being done, how much of it is done, and of how much.

    Returns:
        The ONNX file.

    Raises:
        InvalidField: The folder holds another training.
        MissingExtra: torch or onnx is not installed.
    """
    require("training", "onnx", "torch")
    chosen = settings or FamilySettings()
    check_whole("workers", workers, 1)
    begin(folder, {
        "family": ranges_record(), "rests": rests_record(), "seed": seed,
        "training": asdict(chosen), "demonstrations": drives_record(), "mpc": asdict(MpcSettings()),
        "schema": FAMILY_SCHEMA, "tension_share": FamilyNetwork.tension_share,
    })  # fmt: skip

    def fit(
        k: int, paths: list[Path], told: CountCallback
    ) -> tuple[dict[str, float], WriteCallback]:
        parts = [FamilyDrive.load(each) for each in paths]
        last = parts[-chosen.robots[k] :]
        layers, scores = _fit(parts, chosen, k, seed, told)
        scores |= {
            "lost": float(sum(bool(part.lost) for part in last)),
            "drive_error": median_of_ended([part.error for part in last]),
        }
        description = FamilyDescription(
            ranges=ranges_record(), seed=seed, commit=commit_of_code() or "",
            training={"robots": float(len(parts)), "samples": scores["samples"]},
            scores={name: value for name, value in scores.items() if np.isfinite(value)},
        )  # fmt: skip
        return scores, lambda path: write_family_network(path, layers, description)

    return train_rounds(
        folder, chosen.robots,
        lambda k, network: partial(_drive, seed, chosen.worlds[k], network_file=network),
        fit, columns=TABLE_COLUMNS, drives="robots", workers=workers, report=report,
    )  # fmt: skip


def drives_record() -> dict[str, Any]:
    """Return what the drives of all robots have in common as JSON holds it."""
    usual = asdict(DRIVES)
    own = ("speed_max", "acceleration_max", "spin_spread", "moment_spread", "every", "elsewhere")
    return {name: value for name, value in usual.items() if name not in own} | {
        "path_speed": PATH_SPEED, "path_acceleration": PATH_ACCELERATION,
        "speed_max_over_sqrt_gL": SPEED_MAX, "acceleration_max_over_g": ACCELERATION_MAX,
        "spin_spread_of_platform": SPIN_SPREAD, "moment_spread_of_platform": MOMENT_SPREAD,
        "simulated_time": SIMULATED_TIME, "answers": ANSWERS,
    }  # fmt: skip


def drive_settings(robot: Robot) -> DemonstrationSettings:
    """Return the settings of a drive in numbers for a robot of the family."""
    scales = Scales(robot)
    speed = min(PATH_SPEED * float(robot.speed_max.min()), SPEED_MAX * scales.length / scales.time)
    acceleration = min(
        PATH_ACCELERATION * float(robot.acceleration_max.min()), ACCELERATION_MAX * robot.gravity
    )
    found = resolved(DRIVES, scales.ratios)
    turning = np.sqrt(robot.gravity / np.linalg.norm(robot.anchor_points, axis=1).max())
    return replace(
        found, speed_max=speed, acceleration_max=acceleration,
        spin_spread=SPIN_SPREAD * turning, moment_spread=MOMENT_SPREAD * turning**2,
    )  # fmt: skip


def _drive(seed: int, world: World, number: int, path: Path, *, network_file: Path | None) -> None:
    """Draw a robot, drive it once, and keep what MPC answered."""
    rng = np.random.default_rng([seed, number, 32])
    robot = draw_robot(rng, f"suspended_{number}")
    network = None if network_file is None else FamilyNetwork.load(network_file)
    in_world = _in_model if world == "model" else _in_simulation
    drive = in_world(robot, network, (seed, number), rng)
    with replacing(path) as temporary:
        drive.save(temporary)


def _in_model(
    robot: Robot, network: FamilyNetwork | None, seed: tuple[int, int], rng: np.random.Generator
) -> FamilyDrive:
    """Drive in the model of MPC."""
    reader = FamilyNumbers(robot)
    plan = None if network is None else network.tensions(robot)
    numbers, told, lost = [], [], ""
    try:
        mpc = family_settings(robot)
        for inputs, tension in answers(robot, drive_settings(robot), mpc, rng, plan):
            numbers.append(reader.of(inputs))
            told.append(reader.told(numbers[-1], tension))
    except CarosacError as reason:
        lost = str(reason)
    return _kept(np.array(numbers), np.array(told), float("nan"), lost)


def _in_simulation(
    robot: Robot, network: FamilyNetwork | None, seed: tuple[int, int], rng: np.random.Generator
) -> FamilyDrive:
    """Drive a simulated plant, behind an estimator."""
    reader, scales = FamilyNumbers(robot), Scales(robot)
    longest = SIMULATED_TIME * scales.time
    mpc = family_settings(robot)
    every = max(1, round(longest / mpc.period / ANSWERS))
    settings = replace(drive_settings(robot), every=every)
    found = demonstrate(robot, settings, mpc, seed, network, reader, longest)
    told = np.array([
        reader.told(row, tension)
        for row, tension in zip(found.numbers, found.tension, strict=True)
    ])  # fmt: skip
    return _kept(found.numbers, told, found.error / scales.length, found.lost)


def _kept(numbers: Array, told: Array, error: float, lost: str) -> FamilyDrive:
    """Return a drive of the answers that a network can tell."""
    numbers, told = numbers.reshape(-1, COUNT), told.reshape(-1, CABLES)
    good = np.isfinite(numbers).all(axis=1) & (np.abs(told) < 1.0).all(axis=1)
    return FamilyDrive(numbers=numbers[good], told=told[good], error=error, lost=lost)


def _fit(
    parts: list[FamilyDrive],
    settings: FamilySettings,
    number: int,
    seed: int,
    report: CountCallback,
) -> tuple[Layers, dict[str, float]]:
    """Fit a new network to all answers; return it and its scores, in weights per cable."""
    trained = [part for k, part in enumerate(parts) if not is_held_out(k)]
    others = [part for k, part in enumerate(parts) if is_held_out(k)]
    numbers = np.concatenate([part.numbers for part in trained])
    told = np.concatenate([part.told for part in trained])
    if not len(numbers):
        why = next((part.lost for part in parts if part.lost), "too few robots")
        raise CarosacError(f"distillation: MPC gave no answers that can be learned from ({why})")
    images = [mirror(axes) for axes in IMAGES]
    layers = regress(
        numbers, told, np.full(CABLES, 1.0 / CHANGE_MAX),
        np.full(COUNT, SPREAD_MIN),
        Regression(
            hidden=settings.hidden, updates=settings.updates[number], batch=settings.batch,
            rate=settings.rate, decay=settings.decay, seed=1000 * seed + number,
        ),
        report, images,
    )  # fmt: skip
    return layers, {
        "samples": float(sum(len(part.numbers) for part in parts)),
        "trained_error": _error(layers, trained),
        "held_out_error": _error(layers, others),
    }


def _error(layers: Layers, parts: list[FamilyDrive]) -> float:
    """Return by how much tensions are off, RMS, over the weight per cable."""
    tell = Perceptron(layers)
    off = [tell(part.numbers) - part.told for part in parts]
    return CHANGE_MAX * rms(np.concatenate(off)) if off else float("nan")
