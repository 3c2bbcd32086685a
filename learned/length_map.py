r"""Catenary inverse kinematics, and how soft the rest is, as polynomials: microseconds.

.. math:: L_{catenary}(p) = L_{straight}(p) + \sum_k c_k T_k(x(p)),

with products of Chebyshev polynomials over the workspace box. What sag, stretch and tilt add to
straight lines is smooth but where a tension meets its limit, so a degree of six leaves, over the
box of the robot `carosac`, 0.6 mm in the median and at most a few millimetres, near positions at
which it cannot rest. Higher degrees help little: sixteen leaves 0.1 mm and 5 mm. The
softness, a movement of the rest per acceleration,

.. math:: S(p) = \begin{pmatrix} I & 0 \end{pmatrix} K^{-1}
    \begin{pmatrix} m I \\ m [R c]_\times \end{pmatrix},

with the stiffness K at rest, the mass and its centre c, is fitted the same way.
"""

from __future__ import annotations

import numpy as np

from carosac_toolkit.arrays import Array
from carosac_toolkit.errors import CarosacError
from carosac_toolkit.physics import statics, straight_line
from carosac_toolkit.robot import Robot

DEGREE = 6
NODES = 10  # along each axis
ORDERS = np.arange(DEGREE + 1.0)[:, None, None]


class LengthMap:
    """Lengths of rest, and how it yields to inertia, at positions in a workspace box.

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
        basis = self._basis(points[sound])
        self._coefficients = np.linalg.lstsq(basis, extra[sound], rcond=None)[0]
        soft = softness(robot, rest)[sound].reshape(-1, 9)
        self._softness = np.linalg.lstsq(basis, soft, rcond=None)[0]
        self.largest_error = float(np.abs(basis @ self._coefficients - extra[sound]).max())

    def lengths(self, position: Array) -> Array:
        """Lengths of rest, shape (B, n).

        Beyond the box, sag and tilt are those of its border.

        Args:
            position: In W [m], shape (B, 3).
        """
        straight = straight_line.straight_length(self._robot, position).length
        found: Array = straight + self._basis(position) @ self._coefficients
        return found

    def softness(self, position: Array) -> Array:
        """Movement of the rest per acceleration, as `softness` [s^2], shape (B, 3, 3).

        Beyond the box it is that of its border.

        Args:
            position: In W [m], shape (B, 3).
        """
        found: Array = (self._basis(position) @ self._softness).reshape(-1, 3, 3)
        return found

    def _basis(self, position: Array) -> Array:
        """Chebyshev products up to the total degree, shape (B, K)."""
        unit = ((position - self._center) / self._half).clip(-1.0, 1.0)
        values = np.cos(ORDERS * np.arccos(unit))
        x, y, z = self._powers
        found: Array = (values[x, :, 0] * values[y, :, 1] * values[z, :, 2]).T
        return found


def softness(robot: Robot, rest: statics.Equilibrium) -> Array:
    """How far the rest moves against inertia, lengths held [s^2], shape (B, 3, 3).

    While the platform accelerates with a, in W, its inertia pulls at its centre of mass with -m a;
    the rest then lies S a behind. The platform turns as it likes.

    Args:
        robot: n cables.
        rest: Equilibria of it, B of them.
    """
    center = rest.rotation @ robot.center_of_mass
    moment = np.cross(center[:, None, :], np.eye(3)).transpose(0, 2, 1)  # columns c x e_k
    force = np.broadcast_to(np.eye(3), moment.shape)
    wrench = robot.mass * np.concatenate([force, moment], axis=1)
    found = np.linalg.solve(rest.stiffness, wrench)[:, :3]
    return np.asarray(found, dtype=np.float64)
