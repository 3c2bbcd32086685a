"""Signatures of physical effects in the error of an open-loop simulation.

The signature of an effect is the difference that it makes to the simulation: the robot is simulated
again with the effect, from the same start and on the same lengths. A delay, a turned frame and a
phase of the sway are read off the simulated motion itself.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import chain, pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline, interp1d
from scipy.spatial.transform import Rotation

from carosac_toolkit.base.arrays import Array, evenly
from carosac_toolkit.base.errors import CarosacError, InvalidField
from carosac_toolkit.base.scaled import Scaled
from carosac_toolkit.loop.values import Pose
from carosac_toolkit.physics.device import lever
from carosac_toolkit.physics.motion.winch import lagging_lengths
from carosac_toolkit.physics.rest.modes import mass_matrix, natural_modes
from carosac_toolkit.physics.rest.statics import forward_kinematics
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.recordings.recording import Recording
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.validation.first_motion import SIX_CABLES
from carosac_toolkit.validation.fleet_motion import fleet_motion
from carosac_toolkit.validation.phases import summed_turns
from carosac_toolkit.validation.time_shift import Signal, binned

GRID = Scaled(0.1, "s")  # lengths go straight over no longer time
LENGTH_BIN = Scaled(0.05, "s")  # over which noise of the lengths is averaged
STEP_SHARE = 0.25  # of a prior sigma, with which an effect is simulated
MODE_SAMPLES_MAX = 300  # poses of rest at which free modes are solved for, evenly spread
PHASE_PER_SAMPLE_MAX_RAD = 2.5  # of a mode between samples that still show it
# Prior standard deviations of the sizes of effects: what a calibrated robot may be off by.
DELAY_SIGMA = Scaled(0.05, "s")
PHASE_SIGMA_RAD = 0.5
TILT_SIGMA_RAD = 0.02
CENTER_SIGMA = Scaled(0.02, "m")
OFFSET_SIGMA = Scaled(0.02, "m")
SCALE_SIGMA = 5e-3
HYSTERESIS_SIGMA = Scaled(3e-3, "m")
INERTIA_SIGMA = 0.3  # share
DRAG_SIGMA = 1.0
DRAG_OF_CRITICAL = 0.02  # damping of the slowest mode by a drag of one sigma
EXIT_MOMENT_SIGMA = 2e-3  # of weight per cable times mean cable length
ANCHOR_MOMENT_SIGMA = 0.02  # of weight per cable times lever arm

EFFECTS = (
    "delay", "sway phase", "damping law", "hysteresis", "tilt", "centre of mass",
    "length offset or scale",
)  # fmt: skip
START = "start"  # a sway of one recording, from its first pose on
CENTER_EFFECTS = ("centre of mass", "centre of mass", "sway phase")  # x, y; z tunes the sway


@dataclass(frozen=True, kw_only=True, eq=False)
class Signatures:
    """Motions that effects make at K samples, each for an effect of one prior sigma.

    Attributes:
        motion: For each effect, columns of positions in W [m] and rotation vectors in W times the
            lever arm of the platform [m], shape (K, 6, c).
        start: The same of sways and their speeds at the start, shape (K, 6, 2 m).
        speed: Rate of the simulated motion, in the same measures [m/s], shape (K, 6).
        lever: Lever arm [m].
    """

    motion: dict[str, Array]
    start: Array
    speed: Array
    lever: float


@dataclass(frozen=True, kw_only=True, eq=False)
class _Variant:
    """A robot with an effect, simulated beside the one without.

    Attributes:
        effect: Name of the effect.
        robot: With it.
        length: Unstrained lengths of the robot, shape (M, n).
        back: Rotation by which its poses are turned back, shape (3, 3).
        move: Change of the start, in free modes, shape (6,).
        twist: Change of the twist at the start, shape (6,).
        share: Of one prior sigma.
    """

    effect: str
    robot: Robot
    length: Array
    back: Array = field(default_factory=lambda: np.eye(3))
    move: Array = field(default_factory=lambda: np.zeros(6))
    twist: Array = field(default_factory=lambda: np.zeros(6))
    share: float = STEP_SHARE


def effect_signatures(recording: Recording, robot: Robot, time: Array, pose: Pose) -> Signatures:
    """Simulate the signatures of all effects at K samples.

    Args:
        recording: As calibrated, n cables, with unstrained lengths.
        robot: That was simulated.
        time: Increasing, within the lengths [s], shape (K,), K >= 4.
        pose: Simulated at these times; the first is where the signatures start from.

    Raises:
        CarosacError: The robot cannot be simulated on these lengths.
    """
    ratios = Scales(robot).ratios
    when, rows = _filled(time, GRID.of(ratios))
    samples = Signal(time=recording.time, value=recording.unstrained_length)
    few = binned(samples, LENGTH_BIN.of(ratios))
    inside = np.clip(when - (robot.length_delay or 0.0), few.time[0], few.time[-1])
    length = CubicSpline(few.time, few.value)(inside)
    if not (length > 0.0).all():
        raise InvalidField("unstrained_length", f"{length.min():.3g} m", "positive lengths")
    modes = _FreeModes(robot, when, length)
    move, twist = modes.start(time, pose)
    plain = _Variant(effect="", robot=robot, length=length)
    variants = [plain, *_variants(robot, length, modes)]
    motion = fleet_motion(
        [each.robot for each in variants],
        when,
        np.stack([each.length for each in variants], axis=1),
        move + np.array([each.move for each in variants]),
        twist + np.array([each.twist for each in variants]),
    )
    position, rotation = motion.position[rows], motion.rotation[rows]
    columns: dict[str, list[Array]] = {name: [] for name in (*EFFECTS, START)}
    for b, each in enumerate(variants[1:], start=1):
        there = position[:, b] @ each.back.T - position[:, 0]
        turned = each.back @ rotation[:, b] @ rotation[:, 0].swapaxes(1, 2)
        moved = np.hstack([there, Rotation.from_matrix(turned).as_rotvec()])
        columns[each.effect].append(moved / each.share)
    rate = motion.twist[rows, 0]
    columns["delay"].append(DELAY_SIGMA.of(ratios) * rate)
    columns["tilt"] += list(_turned_frame(position[:, 0]))
    columns["sway phase"] += list(modes.phases(when, time, motion.twist[:, 0], rows))
    if not all(np.isfinite(each).all() for each in (rate, *chain(*columns.values()))):
        raise CarosacError("the motion by an effect is not finite")
    arm = lever(robot)
    arms = np.repeat([1.0, arm], 3)
    begun = [each * arms for each in columns.pop(START)]
    return Signatures(
        motion={k: np.stack(v, axis=2) * arms[:, None] for k, v in columns.items() if v},
        start=np.stack(begun, axis=2) if begun else np.zeros((len(time), 6, 0)),
        speed=rate * arms,
        lever=arm,
    )


def _filled(time: Array, step: float) -> tuple[Array, NDArray[np.intp]]:
    """Return times no farther apart than a step, and which of them are the given ones."""
    counts = np.maximum(np.ceil(np.diff(time) / step - 1e-6), 1.0).astype(np.intp)
    parts = [
        np.linspace(*ends, n, endpoint=False)
        for ends, n in zip(pairwise(time), counts, strict=True)
    ]
    rows = np.concatenate([[0], np.cumsum(counts)])
    return np.concatenate([*parts, time[-1:]]), rows


def _variants(robot: Robot, length: Array, modes: _FreeModes) -> Iterator[_Variant]:
    """Yield the robot with each effect in turn."""
    yield from _lengths(robot, length)
    for axis in np.eye(3)[:2]:
        turn = Rotation.from_rotvec(STEP_SHARE * TILT_SIGMA_RAD * axis).as_matrix()
        tilted = replace(
            robot,
            exit_points=robot.exit_points @ turn.T,
            swivel_axis=robot.swivel_axis @ turn.T,
        )
        yield _Variant(effect="tilt", robot=_plain(tilted), length=length, back=turn.T)
    shift = STEP_SHARE * CENTER_SIGMA.of(Scales(robot).ratios)
    for axis, effect in zip(np.eye(3), CENTER_EFFECTS, strict=True):
        center = robot.center_of_mass + shift * axis
        shifted = _plain(replace(robot, center_of_mass=center))
        yield _Variant(effect=effect, robot=shifted, length=length)
    for turned in _inertias(robot):
        yield _Variant(effect="sway phase", robot=turned, length=length)
    for damped in _dampings(robot, modes.frequency):
        yield _Variant(effect="damping law", robot=damped, length=length)
    size = modes.amplitude
    for shape, frequency in zip(modes.first.T, modes.frequency, strict=True):
        yield _Variant(effect=START, robot=robot, length=length, move=STEP_SHARE * size * shape)
        yield _Variant(
            effect=START, robot=robot, length=length, twist=STEP_SHARE * size * frequency * shape
        )


def _lengths(robot: Robot, length: Array) -> Iterator[_Variant]:
    """Yield the robot on lengths with an offset, a scale and a hysteresis of each cable."""
    ratios = Scales(robot).ratios
    for i in range(robot.n):
        offset, scale = length.copy(), length.copy()
        offset[:, i] += STEP_SHARE * OFFSET_SIGMA.of(ratios)
        scale[:, i] *= 1.0 + STEP_SHARE * SCALE_SIGMA
        widths = np.zeros((1, robot.n))
        widths[0, i] = STEP_SHARE * HYSTERESIS_SIGMA.of(ratios)
        lagging = lagging_lengths(length[:, None], widths)[:, 0]
        yield _Variant(effect="length offset or scale", robot=robot, length=offset)
        yield _Variant(effect="length offset or scale", robot=robot, length=scale)
        yield _Variant(effect="hysteresis", robot=robot, length=lagging)


def _inertias(robot: Robot) -> Iterator[Robot]:
    """Yield robots with more inertia about each axis of P."""
    for k in range(3):
        stretch = np.ones(3)
        stretch[k] = np.sqrt(1.0 + STEP_SHARE * INERTIA_SIGMA)
        spread = 0.5 * np.trace(robot.inertia) * np.eye(3) - robot.inertia
        spread = spread * np.outer(stretch, stretch)
        try:
            yield _plain(replace(robot, inertia=np.trace(spread) * np.eye(3) - spread))
        except InvalidField:
            continue  # a rod or a disk cannot have it


def _dampings(robot: Robot, frequency: Array) -> Iterator[Robot]:
    """Yield robots with more of each damping."""
    if not len(frequency):
        return
    share = robot.weight / robot.n
    rate = STEP_SHARE * DRAG_SIGMA * 2.0 * DRAG_OF_CRITICAL * float(frequency[0])
    moments = {
        "exit_friction": EXIT_MOMENT_SIGMA * share * Scales(robot).length,
        "anchor_friction": ANCHOR_MOMENT_SIGMA * share * lever(robot),
    }
    yield _plain(replace(robot, drag=robot.drag + rate * robot.mass))
    angular = robot.angular_drag + rate * float(np.trace(robot.inertia)) / 3.0
    yield _plain(replace(robot, angular_drag=angular))
    for name, moment in moments.items():
        yield _plain(replace(robot, **{name: getattr(robot, name) + STEP_SHARE * moment}))


def _plain(robot: Robot) -> Robot:
    """Return a robot without the covariance of a calibration, which is no longer its own."""
    return replace(robot, calibrated=None, calibration_covariance=None)


def _turned_frame(position: Array) -> Iterator[Array]:
    """Yield motions of poses by a tilt of their frame about x and y, (K, 6)."""
    for axis in np.eye(3)[:2]:
        turn = np.broadcast_to(axis, position.shape)
        yield TILT_SIGMA_RAD * np.hstack([np.cross(axis, position), turn])


class _FreeModes:
    """Slow modes of the platform along the poses of rest: none with six cables or more.

    Attributes:
        first: Their shapes at the first time, of unit modal mass, shape (6, m).
        frequency: Median [rad/s], shape (m,).
        amplitude: RMS of the modal coordinates of the sway, once `start` has seen it.
    """

    def __init__(self, robot: Robot, time: Array, length: Array) -> None:
        """Solve for poses of rest and modes at some times.

        Args:
            robot: Robot description, n cables.
            time: [s], shape (M,).
            length: [m], shape (M, n).
        """
        some = evenly(len(time), MODE_SAMPLES_MAX)
        rest = forward_kinematics(robot, length[some])
        if not (rest.converged & rest.stable).all():
            raise CarosacError("the robot cannot rest on all of the lengths")
        modes = natural_modes(robot, rest)
        mass = mass_matrix(robot, rest.rotation, rest.unstrained_length)
        m = max(SIX_CABLES - robot.n, 0)
        shape = modes.shape[:, :, :m].copy()
        for k in range(1, len(shape) if m else 0):  # modes may change places: keep the basis
            u, _, v = np.linalg.svd(shape[k].T @ mass[k] @ shape[k - 1])
            shape[k] = shape[k] @ u @ v
        self.first = shape[0]
        self.frequency = 2.0 * np.pi * np.median(np.abs(modes.frequency[:, :m]), axis=0)
        self._time = time[some]
        self._shape = shape
        self._to_modes = shape.swapaxes(1, 2) @ mass
        self._rest = rest
        self.amplitude = 0.0

    def start(self, time: Array, pose: Pose) -> tuple[Array, Array]:
        """Return how far poses are from rest at first, and how fast they leave it, each (6,).

        Only free modes count; those that the poses are too few for are left out.
        """
        nearest = np.searchsorted(self._time, time).clip(0, len(self._time) - 1)
        turn = pose.rotation @ self._rest.rotation[nearest].swapaxes(1, 2)
        where = self._at(self._rest.position, time)
        away = np.hstack([pose.position - where, Rotation.from_matrix(turn).as_rotvec()])
        modal = np.einsum("kij,kj->ki", self._at(self._to_modes, time), away)
        seen = self.frequency * np.median(np.diff(time)) < PHASE_PER_SAMPLE_MAX_RAD
        self.amplitude = float(np.sqrt((modal[:, seen] ** 2).mean())) if seen.any() else 0.0
        rate = CubicSpline(time, modal)(time[0], 1)
        return self.first @ (seen * modal[0]), self.first @ (seen * rate)

    def phases(
        self, when: Array, time: Array, twist: Array, rows: NDArray[np.intp]
    ) -> Iterator[Array]:
        """Yield motions by a phase of each mode, constant and growing, (K, 6).

        Args:
            when: Of the twists [s], shape (M,).
            time: Asked for [s], shape (K,).
            twist: Simulated, in W, shape (M, 6).
            rows: Of the times asked for, shape (K,).
        """
        turned = summed_turns(self._rest.rotation)
        path = CubicSpline(self._time, np.hstack([self._rest.position, turned]))
        modal = np.einsum("kij,kj->ki", self._at(self._to_modes, when), twist - path(when, 1))
        shape = self._at(self._shape, time)
        grown = (time - time[0]) / (time[-1] - time[0])
        for j, frequency in enumerate(self.frequency):
            along = PHASE_SIGMA_RAD / frequency * shape[:, :, j] * modal[rows, j : j + 1]
            yield along
            yield along * grown[:, None]

    def _at(self, value: Array, time: Array) -> Array:
        """Return values along the path at other times."""
        inside = np.clip(time, self._time[0], self._time[-1])
        return np.asarray(interp1d(self._time, value, axis=0)(inside))
