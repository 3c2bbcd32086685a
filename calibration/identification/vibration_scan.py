"""Stiffness and damping of cables by how a platform vibrates in many recordings.

A search that follows vibrations sees their phase, and takes for a solution every stiffness by which
this is in step for a while. What does not depend on phases is how much of the poses, beside a slow
sway, the modes of a robot explain as they ring and die out: linear regressions on them, for many
stiffnesses, of all recordings together, and for many dampings at the likeliest stiffness. A cable
whose axial damping over its stiffness is a time T lets a mode die out at w^2 T / 2.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calibration.identification.measured_poses import MeasuredPoses, rotation_vectors
from calibration.identification.open_loop import first_equilibrium
from calibration.identification.runs import FittedRun, fastest_sway, sway_basis, sway_degree
from calibration.identification.unknowns import Coordinates
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.physics.rest.modes import Modes, natural_modes
from carosac_toolkit.robot.robot import Robot

STIFFNESS_STEP = 0.01  # of its logarithm: a third of what the line of a fast vibration is wide
SWAYS = 3.0  # periods of the fastest sway in which vibrations are looked for
# Of that time, in which they are taken to fall by a factor of e before their damping is known.
DECAY_SHARE = 2.0 / 3.0
DAMPING_STEP = 0.1  # the same of the damping
CABLE_FIELDS = ("axial_stiffness", "axial_damping")
REACH_SIGMAS = 3.0  # of what is known before, within which both are sought
APART_RATIO_MIN = 1.25  # of a vibration to the fastest motion that goes for a sway
CHANCE_SIGMAS = 5.0  # of the power that noise explains, beyond which vibrations are seen


@dataclass(frozen=True, kw_only=True)
class CableFactors:
    """Factors by which the stiffness and the axial damping of cables are higher than in a robot."""

    stiffness: float
    damping: float


def as_vibrating(
    unknowns: Coordinates, runs: Sequence[FittedRun], at: Array, sigma: Array
) -> Array | None:
    """Return coordinates (k,) with the cables that vibrations show; None: none are seen.

    Args:
        unknowns: Of a robot.
        runs: Recordings; there may be none.
        at: Nearly those of the robot, but for its cables, shape (k,).
        sigma: How far off these may be, shape (k,).
    """
    stiffness, damping = (unknowns.log_sigma(field, sigma) for field in CABLE_FIELDS)
    if not runs or not (stiffness or damping):
        return None
    found = cable_factors(unknowns.robot_at(at), runs, stiffness, damping)
    if found is None:
        return None
    for field, factor in zip(CABLE_FIELDS, (found.stiffness, found.damping), strict=True):
        at = unknowns.multiplied(at, field, factor)
    return at


def cable_ways(unknowns: Coordinates, at: Array, sigma: Array) -> Array:
    """Return changes of a robot by one sigma of its cables' stiffness and damping, (q, k).

    None of what is held.

    Args:
        unknowns: Of a robot.
        at: Its coordinates, shape (k,).
        sigma: How far off these may be, shape (k,).
    """
    changes = [
        unknowns.multiplied(at, field, float(np.exp(unknowns.log_sigma(field, sigma)))) - at
        for field in CABLE_FIELDS
    ]
    return np.array([each for each in changes if each.any()]).reshape(-1, len(at))


def cable_factors(
    robot: Robot, runs: Sequence[FittedRun], stiffness_sigma: float, damping_sigma: float
) -> CableFactors | None:
    """Return how stiff cables are, and how they damp, by vibrations; None: none are seen.

    Args:
        robot: Nearly the one that moved, but for its cables; n < 6 of them.
        runs: Recordings.
        stiffness_sigma: Sigma before of the logarithm of the EA; 0: it is held.
        damping_sigma: The same of the axial damping.
    """
    rests = [first_equilibrium(robot, run.path) for run in runs]
    lengths = np.concatenate([rest.unstrained_length for rest in rests])
    sway = max(fastest_sway(robot, rest) for rest in rests)
    span = SWAYS / sway
    degree = sway_degree(span, sway)
    fast = [_Fast.of(run.poses, span, degree) for run in runs]
    least = APART_RATIO_MIN * degree / (2.0 * span)  # of polynomials, at their ends a little more

    def stiffer(log: float) -> Modes | None:
        other = replace(robot, axial_stiffness=np.exp(log) * robot.axial_stiffness)
        there = statics.forward_kinematics(other, lengths)
        return natural_modes(other, there) if there.converged.all() else None

    def power(modes: Modes, rate: Array) -> float:
        explained = (
            each.explained(modes, rate, row, least)
            for row, each in enumerate(fast) if each is not None
        )  # fmt: skip
        return float(sum(explained))

    logs = _around(stiffness_sigma, STIFFNESS_STEP)
    stiff = [stiffer(log) for log in logs]
    unknown = np.full(6, 1.0 / (DECAY_SHARE * span))
    told = np.array([0.0 if modes is None else power(modes, unknown) for modes in stiff])
    freedoms = 2.0 * robot.n * sum(each is not None for each in fast)
    if told.max() <= CHANCE_SIGMAS * np.sqrt(2.0 * freedoms):
        return None
    best = _likeliest(logs, told, stiffness_sigma)
    stiffness, modes = float(logs[best]), stiff[best]
    assert modes is not None, "it explains something"
    stiffest = np.exp(stiffness) * robot.axial_stiffness
    squared = (2.0 * np.pi * modes.frequency.mean(axis=0)) ** 2
    rate = 0.5 * squared * float((robot.axial_damping / stiffest).mean())
    logs = _around(damping_sigma, DAMPING_STEP)
    told = np.array([power(modes, np.exp(log) * rate) for log in logs])
    damping = float(logs[_likeliest(logs, told, damping_sigma)])
    return CableFactors(stiffness=float(np.exp(stiffness)), damping=float(np.exp(damping)))


def _around(sigma: float, step: float) -> Array:
    """Return logarithms of factors to try, 0 among them, shape (F,)."""
    reach = REACH_SIGMAS * sigma
    return np.linspace(-reach, reach, 1 + 2 * math.ceil(reach / step))


def _likeliest(logs: Array, power: Array, sigma: float) -> int:
    """Return which logarithm is likeliest by an explained power (F,), with what was known."""
    before = (logs / sigma) ** 2 if sigma else np.zeros(len(logs))
    return int(np.argmax(power - before))


@dataclass(frozen=True, kw_only=True, eq=False)
class _Fast:
    """What is fast in the first poses of a recording.

    Attributes:
        time: Since the first pose [s], shape (K,).
        basis: Orthonormal polynomials of the sway in columns, shape (K, d).
        motion: What these leave of positions in W and of rotations about its axes, over how much it
            scatters, shape (K, 6).
        scatter: Of positions [m] and rotations [rad], shape (6,).
    """

    time: Array
    basis: Array
    motion: Array
    scatter: Array

    @classmethod
    def of(cls, poses: MeasuredPoses, span: float, degree: int) -> _Fast | None:
        """Take the poses of a time [s]; None where they are too few for polynomials of a degree."""
        time = poses.time - poses.time[0]
        rows = time <= span
        freedoms = int(rows.sum()) - degree - 1
        if freedoms < degree:
            return None
        first = poses.rotation[0]
        turned = rotation_vectors(first.T @ poses.rotation[rows]) @ first.T
        motion = np.hstack([poses.position[rows], turned])
        basis = sway_basis(time[rows], span, degree)
        motion = motion - basis @ (basis.T @ motion)
        power = (motion**2).reshape(-1, 2, 3).sum(axis=(0, 2)) / (3 * freedoms)
        scatter = np.repeat(np.sqrt(power), 3)
        return cls(time=time[rows], basis=basis, motion=motion / scatter, scatter=scatter)

    def explained(self, modes: Modes, rate: Array, row: int, least: float) -> float:
        """Return how much of the motion is explained by modes, beyond what noise lets them.

        Args:
            modes: At all places.
            rate: At which each dies out [1/s], shape (6,).
            row: Of the place.
            least: Frequency from which one is no sway [Hz].
        """
        columns = []
        for mode in np.flatnonzero(modes.frequency[row] > least):
            shape = modes.shape[row, :, mode] / self.scatter
            wave = np.exp((2j * np.pi * modes.frequency[row, mode] - rate[mode]) * self.time)
            for part in (wave.real, wave.imag):
                ringing = part - self.basis @ (self.basis.T @ part)
                columns.append(np.outer(ringing, shape).ravel())
        if not columns:
            return 0.0
        slopes, motion = np.array(columns).T, self.motion.ravel()
        explained = motion @ (slopes @ np.linalg.lstsq(slopes, motion, rcond=None)[0])
        return float(explained) - len(columns)
