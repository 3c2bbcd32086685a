r"""Catenary inverse kinematics over the workspace as a polynomial: microseconds instead of a solve.

.. math:: L_{catenary}(p) = L_{straight}(p) + \sum_k c_k T_k(x(p)),

with products of Chebyshev polynomials over the workspace box. What sag, stretch and tilt add to
straight lines is smooth but where a tension meets its limit, so a degree of six leaves, over the
box of the robot `carosac`, 0.6 mm in the median and at most a few millimetres, near positions at
which it cannot rest. Higher degrees help little: sixteen leaves 0.1 mm and 5 mm.
"""

from __future__ import annotations

import numpy as np

from carosac_toolkit.arrays import Array
from carosac_toolkit.errors import CarosacError, InvalidField
from carosac_toolkit.physics import statics, straight_line
from carosac_toolkit.robot import Robot

DEGREE = 6
NODES = 10  # along each axis
OUTSIDE = 0.02  # by how much of half an edge a position may lie outside the box


class LengthMap:
    """Lengths of rest at positions in a workspace box.

    Attributes:
        largest_error: Against inverse kinematics at all nodes that are feasible [m].
        feasible: Share of the nodes at which the robot can rest.
    """

    def __init__(self, robot: Robot) -> None:
        """Fit to the feasible nodes of a Chebyshev grid.

        Raises:
            CarosacError: The robot can rest at too few of them.
        """
        self._robot = robot
        self._center = (robot.workspace_max + robot.workspace_min) / 2
        self._half = (robot.workspace_max - robot.workspace_min) / 2
        axis = np.cos(np.pi * (np.arange(NODES) + 0.5) / NODES)
        unit = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
        points = self._center + self._half * unit
        rest = statics.inverse_kinematics(robot, points)
        sound = rest.converged & rest.stable
        self.feasible = float(sound.mean())
        powers = np.stack(np.meshgrid(*[np.arange(DEGREE + 1)] * 3, indexing="ij"), -1)
        self._powers = powers[powers.sum(axis=-1) <= DEGREE].T  # (3, K)
        if sound.sum() < 2 * self._powers.shape[1]:
            share = f"{100 * self.feasible:.0f} %"
            raise CarosacError(f"{robot.name}: it can rest at {share} of its workspace box only")
        extra = rest.unstrained_length - straight_line.straight_length(robot, points).length
        basis = self._basis(unit[sound])
        self._coefficients = np.linalg.lstsq(basis, extra[sound], rcond=None)[0]
        self.largest_error = float(np.abs(basis @ self._coefficients - extra[sound]).max())

    def lengths(self, position: Array, displacement: Array) -> Array:
        """Lengths that move the rest from a position by a displacement [m], shape (B, n).

        A displacement may leave the box; sag and tilt are those of its border then.

        Args:
            position: In W [m], in the workspace box, shape (B, 3).
            displacement: In W [m], shape (B, 3).

        Raises:
            InvalidField: A position outside the box.
        """
        unit = (position - self._center) / self._half
        if not (np.abs(unit) <= 1.0 + OUTSIDE).all():
            row = int(np.argmax(np.abs(unit).max(axis=1)))
            low, high = self._robot.workspace_min, self._robot.workspace_max
            allowed = f"positions in the workspace box, {low} m to {high} m"
            raise InvalidField(f"position[{row}]", f"{position[row].round(3)} m", allowed)
        straight = straight_line.straight_length(self._robot, position + displacement).length
        moved = np.clip(unit + displacement / self._half, -1.0, 1.0)
        found: Array = straight + self._basis(moved) @ self._coefficients
        return found

    def _basis(self, unit: Array) -> Array:
        """Chebyshev products up to the total degree, shape (B, K)."""
        values = np.empty((DEGREE + 1, *unit.shape))
        values[0], values[1] = 1.0, unit
        for k in range(2, DEGREE + 1):
            values[k] = 2.0 * unit * values[k - 1] - values[k - 2]
        x, y, z = self._powers
        found: Array = (values[x, :, 0] * values[y, :, 1] * values[z, :, 2]).T
        return found
