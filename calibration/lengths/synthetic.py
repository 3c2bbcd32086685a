"""Recordings with the whole measurement model, from a robot that differs from its description."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calibration.lengths.settings import LengthSettings
from calibration.lengths.unknowns import LengthUnknowns, find_unknowns
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import CarosacError
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.recordings.encoders import readings
from carosac_toolkit.recordings.metadata import RecordingMetadata
from carosac_toolkit.recordings.poses import PoseSamples
from carosac_toolkit.recordings.recording import Recording
from carosac_toolkit.robot.parameters import with_values
from carosac_toolkit.robot.robot import Robot

SAMPLE_PERIOD_S = 0.2  # as of a motion capture at 5 Hz
LENGTH_NOISE_M = 2e-3  # as of winch encoders, with errors of winding
POSITION_NOISE_M, ROTATION_NOISE_RAD = 1e-3, 0.5e-3  # as of a motion capture in a hall
BLUNDER_MIN_M, BLUNDER_MAX_M = 0.05, 0.5
MOVE_TIME_S = 4.0  # [s] from stop to stop
POSES_CHECKED_PER_MOVE = 41  # poses of a move that have to be equilibria
STOP_TRIES_MAX = 200
PATH_TRIES_MAX = 20


@dataclass(frozen=True, kw_only=True, eq=False)
class LengthScene:
    """A recording and the truth behind it.

    Attributes:
        recording: The measurements.
        plant: The robot that it was measured on.
        truth: Values of its parameters by name.
        outlier: True for blunders, shape (S, n).
    """

    recording: Recording
    plant: Robot
    truth: dict[str, float]
    outlier: NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True)
class LengthSceneSettings:
    """Settings of a synthetic recording.

    Attributes:
        samples: Number of poses.
        outliers: Share of the readings that are blunders [1].
        spread: Share of the workspace box that the path uses, per axis [1].
        turn: Largest rotation of a platform that can be turned, per axis [rad].
    """

    samples: int = 500
    outliers: float = 0.05
    spread: tuple[float, float, float] = (1.0, 1.0, 1.0)
    turn: float = 0.2


def draw_length_scene(
    robot: Robot,
    rng: np.random.Generator,
    *,
    settings: LengthSceneSettings | None = None,
    prior: LengthSettings | None = None,
    relative: bool = False,
) -> LengthScene:
    """Draw a plant from the priors, move it quasi-statically through its workspace, measure.

    Args:
        robot: The description; its covariances are priors.
        rng: Source of everything random.
        settings: Settings of the measurement.
        prior: Spread of the plant about the description; offsets are drawn within 0.2 m.
        relative: True if the readings are lengths up to an unknown constant.
    """
    made, known = settings or LengthSceneSettings(), prior or LengthSettings()
    close = replace(known, offset_prior=min(known.offset_prior, 0.2))
    unknowns = find_unknowns(robot, close, relative=False)
    drawn = rng.multivariate_normal(unknowns.prior.mean, unknowns.prior.covariance)
    truth = dict(zip(unknowns.prior.names, drawn.tolist(), strict=True))
    plant = _plant(unknowns, drawn)
    delay = truth.get("length_delay", 0.0)
    time = np.asarray(
        1.0 + SAMPLE_PERIOD_S * np.arange(made.samples), np.float64
    )  # delays are shorter than 1 s
    there, later = _drive(plant, made, time, delay, rng)
    outlier = rng.random((made.samples, robot.n)) < made.outliers
    size = rng.uniform(BLUNDER_MIN_M, BLUNDER_MAX_M, outlier.shape)
    read = readings(plant, later.unstrained_length)
    read = read + LENGTH_NOISE_M * rng.standard_normal(read.shape)
    read = read + np.where(outlier, size * rng.choice([-1.0, 1.0], size.shape), 0.0)
    poses = _measured(plant, there, time, made, rng)
    kind = "unstrained"
    if relative:
        zero = readings(plant, later.unstrained_length)[0]
        read, kind = read - zero, "relative"
        for cable, value in zip(robot.cable_names, zero.tolist(), strict=True):
            truth[f"length_offset[{cable}]"] -= value
    metadata = RecordingMetadata(
        robot=robot.name, length_kind=kind, created_by="calibration.lengths.synthetic",
        description="synthetic: cable lengths and poses of a robot that differs from its file",
    )  # fmt: skip
    recording = Recording(time=time, unstrained_length=read, poses=poses, metadata=metadata)
    return LengthScene(recording=recording, plant=plant, truth=truth, outlier=outlier)


def _plant(unknowns: LengthUnknowns, value: Array) -> Robot:
    """Return the robot in W, z up; exit points not anchored are drawn in the poses' frame."""
    plant = with_values(unknowns.robot, unknowns.prior.names, value)
    if unknowns.anchored or plant.pose_rotation is None:
        return plant
    return replace(plant, exit_points=plant.exit_points @ plant.pose_rotation.T)


def _drive(
    plant: Robot, made: LengthSceneSettings, time: Array, delay: float, rng: np.random.Generator
) -> tuple[statics.Equilibrium, statics.Equilibrium]:
    """Return the equilibria of a random path at some times and `delay` later."""
    for _ in range(PATH_TRIES_MAX):
        path = _Path(plant, made, rng)
        there, later = path.at(time), path.at(time + delay)
        if there.converged.all() and later.converged.all():
            return there, later
    raise CarosacError(f"robot {plant.name} finds no equilibria on any of {PATH_TRIES_MAX} paths")


class _Path:
    """A platform that is driven from edge to edge of its workspace, an equilibrium at any time.

    Moves between random points on the edges of the box, smooth to the acceleration; poses near
    the edges tell more than those in the middle.
    """

    def __init__(self, plant: Robot, made: LengthSceneSettings, rng: np.random.Generator) -> None:
        self._plant, self._made = plant, made
        moves = int(np.ceil((made.samples * SAMPLE_PERIOD_S + 2.0) / MOVE_TIME_S)) + 1
        self._stops = [self._free_stop(rng)]
        for _ in range(moves):
            self._stops.append(self._next_stop(rng))

    def at(self, time: Array) -> statics.Equilibrium:
        """Return the equilibria at some times after the start [s]."""
        stops = np.array(self._stops)
        number = np.clip((time / MOVE_TIME_S).astype(int), 0, len(stops) - 2)
        return self._hold(_between(stops[number], stops[number + 1], time / MOVE_TIME_S - number))

    def _hold(self, stop: Array) -> statics.Equilibrium:
        """Solve equilibria at shares of the workspace box and of the largest turn, shape (B, 6)."""
        from scipy.spatial.transform import Rotation

        robot = self._plant
        middle = 0.5 * (robot.workspace_min + robot.workspace_max)
        half = 0.5 * (robot.workspace_max - robot.workspace_min) * self._made.spread
        rotation = None
        if robot.n >= 6:
            turn = Rotation.from_rotvec(self._made.turn * stop[:, 3:]).as_matrix()
            rotation = turn @ robot.home_rotation
        return statics.inverse_kinematics(robot, middle + half * stop[:, :3], rotation)

    def _free_stop(self, rng: np.random.Generator) -> Array:
        """Draw a point on an edge of the box, and a turn."""
        stop = rng.uniform(-1.0, 1.0, 6)
        ends = rng.permutation(3)[:2]
        stop[ends] = np.sign(stop[ends])
        return stop

    def _next_stop(self, rng: np.random.Generator) -> Array:
        """Draw a stop that the platform can be driven to from the last one."""
        share = np.linspace(0.0, 1.0, POSES_CHECKED_PER_MOVE)
        for _ in range(STOP_TRIES_MAX):
            stop = self._free_stop(rng)
            if self._hold(_between(self._stops[-1], stop, share)).converged.all():
                return stop
            if len(self._stops) == 1:  # the first one may be out of reach itself
                self._stops = [self._free_stop(rng)]
        raise CarosacError(
            f"robot {self._plant.name} can hardly be moved within {self._made.spread} of its "
            "workspace box: make the spread or the turns smaller"
        )


def _between(start: Array, end: Array, share: Array) -> Array:
    """Return the points on the way from one stop to the next, with no jump of the acceleration."""
    smooth = share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
    return np.asarray(start + smooth[:, None] * (end - start))


def _measured(
    plant: Robot, rest: statics.Equilibrium, time: Array, made: LengthSceneSettings,
    rng: np.random.Generator,
) -> PoseSamples:  # fmt: skip
    """Draw measured poses with noise, in the frame of the motion capture."""
    from scipy.spatial.transform import Rotation

    turn = np.eye(3) if plant.pose_rotation is None else plant.pose_rotation
    noise = ROTATION_NOISE_RAD * rng.standard_normal((len(time), 3))
    position = rest.position + POSITION_NOISE_M * rng.standard_normal((len(time), 3))
    rotation = Rotation.from_rotvec(noise).as_matrix() @ rest.rotation
    return PoseSamples.from_rotation(time, position @ turn, turn.T @ rotation)
