"""Stiffness of cables by the frequencies at which a platform vibrates in many recordings.

A search that follows vibrations sees their phase, and takes for a solution every stiffness by which
this is in step for a while. What does not depend on phases is how much of the poses, beside a slow
sway, the modes of a robot explain as they ring and die out: linear regressions on them, for many
stiffnesses, of all recordings together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calibration.identification.measured_poses import MeasuredPoses, rotation_vectors
from calibration.identification.open_loop import first_equilibrium
from calibration.identification.runs import FittedRun, fastest_sway, sway_basis, sway_degree
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.physics.rest.modes import Modes, natural_modes
from carosac_toolkit.robot.robot import Robot

STEP = 0.01  # of the logarithm of the stiffness: a tenth of what a line is wide
SWAYS = 3.0  # periods of the fastest sway in which vibrations are looked for
DECAY_SHARE = 2.0 / 3.0  # of that time, in which they are taken to fall by a factor of e
APART_RATIO_MIN = 1.25  # of a vibration to the fastest motion that goes for a sway
CHANCE_SIGMAS = 5.0  # of the power that noise explains, beyond which vibrations are seen


def stiffness_factor(robot: Robot, runs: Sequence[FittedRun], reach: float) -> float | None:
    """Return how much stiffer cables are by the vibrations of a platform; None: none are seen.

    Args:
        robot: Nearly the one that moved, but for the stiffness of its cables; n < 6 of them.
        runs: Recordings.
        reach: Largest logarithm of the factor, either way.
    """
    rests = [first_equilibrium(robot, run.path) for run in runs]
    lengths = np.concatenate([rest.unstrained_length for rest in rests])
    sway = max(fastest_sway(robot, rest) for rest in rests)
    span = SWAYS / sway
    degree = sway_degree(span, sway)
    fast = [_Fast.of(run.poses, span, degree) for run in runs]
    least = APART_RATIO_MIN * degree / (2.0 * span)  # of polynomials, at their ends a little more
    logs = np.linspace(-reach, reach, 1 + 2 * round(reach / STEP))
    power = np.zeros(len(logs))
    for k, log in enumerate(logs):
        other = replace(robot, axial_stiffness=np.exp(log) * robot.axial_stiffness)
        there = statics.forward_kinematics(other, lengths)
        if there.converged.all():
            modes = natural_modes(other, there)
            power[k] = sum(
                each.explained(modes, row, least)
                for row, each in enumerate(fast) if each is not None
            )  # fmt: skip
    freedoms = 2.0 * robot.n * sum(each is not None for each in fast)
    best = int(np.argmax(power))
    if power[best] - freedoms <= CHANCE_SIGMAS * np.sqrt(2.0 * freedoms):
        return None
    return float(np.exp(logs[best]))


@dataclass(frozen=True, kw_only=True, eq=False)
class _Fast:
    """What is fast in the first poses of a recording.

    Attributes:
        time: Since the first pose [s], shape (K,).
        basis: Orthonormal polynomials of the sway in columns, shape (K, d).
        motion: What these leave of positions in W and of rotations about its axes, over how much it
            scatters, shape (K, 6).
        scatter: Of positions [m] and rotations [rad], shape (6,).
        decay: Time in which vibrations are taken to fall by a factor of e [s].
    """

    time: Array
    basis: Array
    motion: Array
    scatter: Array
    decay: float

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
        return cls(
            time=time[rows], basis=basis, motion=motion / scatter, scatter=scatter,
            decay=DECAY_SHARE * span,
        )  # fmt: skip

    def explained(self, modes: Modes, row: int, least: float) -> float:
        """Return how much of the motion modes at a place explain that are faster than the least."""
        columns = []
        for mode in np.flatnonzero(modes.frequency[row] > least):
            shape = modes.shape[row, :, mode] / self.scatter
            wave = np.exp((2j * np.pi * modes.frequency[row, mode] - 1.0 / self.decay) * self.time)
            for part in (wave.real, wave.imag):
                ringing = part - self.basis @ (self.basis.T @ part)
                columns.append(np.outer(ringing, shape).ravel())
        if not columns:
            return 0.0
        slopes, motion = np.array(columns).T, self.motion.ravel()
        return float(motion @ (slopes @ np.linalg.lstsq(slopes, motion, rcond=None)[0]))
