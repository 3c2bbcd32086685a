"""Present knowledge of a robot, and what it says of samples that are not taken yet."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calibration.self_calibration.balance import expected_tension
from calibration.self_calibration.frame import mean_distance
from calibration.self_calibration.motor_angles import MotorAngles
from calibration.self_calibration.problem import MotorAngleProblem
from calibration.self_calibration.settings import SelfCalibrationSettings
from calibration.self_calibration.solver import whiten
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.physics.cable.drum import drums_of


@dataclass(frozen=True, kw_only=True, eq=False)
class Knowledge:
    """Present knowledge of a robot: the values of the shared unknowns and their covariance.

    Attributes:
        problem: Names and places of the m shared unknowns; its samples do not count.
        settings: Its settings.
        shared: Values, shape (m,).
        covariance: Shape (m, m).
        line_sigma: Noise of the line paid out [m].
    """

    problem: MotorAngleProblem
    settings: SelfCalibrationSettings
    shared: Array
    covariance: Array
    line_sigma: float

    @property
    def exit_points(self) -> Array:
        """Exit points in W [m], shape (n, 3)."""
        return np.asarray(self.shared[self.problem.exits])

    @property
    def exit_covariance(self) -> Array:
        """Joint covariance of the exit points without turns about home [m^2], (3 n, 3 n)."""
        rows = self.problem.exits.ravel()
        return np.asarray(self.without_turns[np.ix_(rows, rows)])

    @property
    def without_turns(self) -> Array:
        """Covariance of the shared unknowns without turns of the exit points about home, (m, m)."""
        rows, keep = self.problem.exits.ravel(), np.eye(len(self.shared))
        keep[np.ix_(rows, rows)] = self._not_turns @ self._not_turns.T
        return np.asarray(keep @ self.covariance @ keep)

    @property
    def exit_sigma(self) -> Array:
        """One standard deviation of each exit point along its worst direction [m], shape (n,)."""
        n = len(self.problem.exits)
        blocks = self.exit_covariance.reshape(n, 3, n, 3)[np.arange(n), :, np.arange(n)]
        return np.asarray(np.sqrt(np.maximum(np.linalg.eigvalsh(blocks)[:, -1], 0.0)))

    @property
    def _not_turns(self) -> Array:
        """Orthonormal directions of the exit points that are no turns about home, (3 n, k)."""
        arm = self.exit_points - self.problem.robot.home_position
        turned = np.stack([np.cross(axis, arm).ravel() for axis in np.eye(3)], axis=1)
        directions, size, _ = np.linalg.svd(turned)
        return np.asarray(directions[:, int((size > 1e-9 * size[0]).sum()) :])

    @property
    def exit_distance(self) -> float:
        """Root mean square distance of an exit point from the truth, averaged over them [m]."""
        return mean_distance(self.exit_covariance)

    def volume(self, covariance: Array) -> Array:
        """Return the log of the squared volume of exit points' covariances, shape (C,).

        Args:
            covariance: Of the exit points, turns included [m^2], shape (C, 3 n, 3 n).
        """
        keep = self._not_turns
        sign, size = np.linalg.slogdet(keep.T @ covariance @ keep)
        return np.asarray(np.where(sign > 0.0, size, np.inf))


def expected_angles(known: Knowledge, position: Array) -> Array:
    """Return the motor angles that positions will show by what is known [rad], shape (C, n).

    Args:
        known: Present knowledge.
        position: Platform origin in W [m], shape (C, 3).
    """
    problem, shared = known.problem, known.shared
    length, _ = problem.straight(shared, position)
    if problem.angles.tension is not None:
        tension = expected_tension(problem, shared, position)
        robot = problem.robot
        strain = tension * (1.0 + shared[problem.compliances]) / robot.axial_stiffness
        length = (length - robot.run_length * strain) / (1.0 + strain)
    drums = replace(
        drums_of(problem.robot),
        radius=problem.radius + shared[problem.radii],
        buildup=shared[problem.buildups],
    )
    return drums.motor_angle(length - shared[problem.zeros])


def problem_at(known: Knowledge, position: Array) -> MotorAngleProblem:
    """Return the problem of samples that would be taken at these positions."""
    problem, tension = known.problem, None
    if problem.angles.tension is not None:
        tension = expected_tension(problem, known.shared, position)
    angles = MotorAngles(
        samples=tuple(str(k) for k in range(len(position))),
        cables=problem.robot.cable_names,
        motor_angle=expected_angles(known, position),
        known_position=position,
        is_known=np.ones(len(position), dtype=np.bool_),
        tension=tension,
    )
    return MotorAngleProblem(problem.robot, angles, known.settings)


def spare_directions(slope: Array) -> Array:
    """Return the changes of the lengths that no move of the platform makes, (C, n, n - 3).

    Args:
        slope: Change of the lengths with the position, shape (C, n, 3).
    """
    return np.asarray(np.linalg.svd(slope)[0][:, :, slope.shape[2] :])


def spare_lengths(known: Knowledge, position: Array) -> Array:
    """Return the whitened derivatives of the lengths that a position leaves, (C, n - 3, m).

    Args:
        known: Present knowledge.
        position: Platform origin in W [m], shape (C, 3).
    """
    white = whiten(problem_at(known, position), known.shared, position, known.line_sigma)
    return np.asarray(spare_directions(white.by_own).swapaxes(1, 2) @ white.by_shared)
