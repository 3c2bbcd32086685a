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

from typing import Any

import numpy as np
import warp as wp

from carosac_toolkit.base.arrays import Array, batch
from carosac_toolkit.base.errors import CarosacError
from carosac_toolkit.physics import warp_setup
from carosac_toolkit.physics.cable import straight_line
from carosac_toolkit.physics.device import Buffers
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.robot.robot import Robot
from learned import length_map_kernels

POLYNOMIAL_DEGREE = 6
CHEBYSHEV_NODES = 10  # along each axis
GEOMETRY_FIELDS = ("exit_points", "anchor_points", "pulley_radius", "swivel_axis")
ZERO_VECTOR = np.zeros(3)


class LengthMap:
    """Lengths of rest, and how it yields to inertia, at positions in a workspace box.

    Attributes:
        largest_error: Against inverse kinematics at all nodes that are feasible [m].
        feasible: Share of the nodes at which the robot can rest.
    """

    def __init__(self, robot: Robot, device: str = "cpu") -> None:
        """Fit to the feasible nodes of a Chebyshev grid.

        Args:
            robot: Whose lengths they are.
            device: Warp device that evaluates it.

        Raises:
            CarosacError: The robot can rest at too few of them.
        """
        self._robot = robot
        self._device = device
        center = (robot.workspace_max + robot.workspace_min) / 2
        half = (robot.workspace_max - robot.workspace_min) / 2
        axis = np.cos(np.pi * (np.arange(CHEBYSHEV_NODES) + 0.5) / CHEBYSHEV_NODES)
        unit = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
        points = center + half * unit
        rest = statics.inverse_kinematics(robot, points)
        sound = rest.converged & rest.stable
        self.feasible = float(sound.mean())
        basis = products(unit[sound])
        if len(basis) < 2 * basis.shape[1]:
            share = f"{100 * self.feasible:.0f} %"
            raise CarosacError(f"{robot.name}: it can rest at {share} of its workspace box only")
        extra = rest.unstrained_length - straight_line.straight_length(robot, points).length
        soft = softness(robot, rest)[sound].reshape(-1, 9)
        coefficients = np.linalg.lstsq(basis, np.hstack([soft, extra[sound]]), rcond=None)[0]
        both = np.asarray(coefficients, dtype=np.float64)
        self._softness, self._extra = both[:, :9].reshape(-1, 3, 3), both[:, 9:]
        self.largest_error = float(np.abs(basis @ self._extra - extra[sound]).max())
        self._arguments = (
            "target", "offset", "push", POLYNOMIAL_DEGREE, wp.vec3d(center), wp.vec3d(half),
            "softness", "extra", wp.mat33d(robot.home_rotation), *GEOMETRY_FIELDS, "place",
            "length",
        )  # fmt: skip
        self._kept: tuple[int, Buffers] | None = None  # of the last batch, with its size

    def __getstate__(self) -> dict[str, Any]:
        """Return all but the buffers, which are made when they are needed."""
        return self.__dict__ | {"_kept": None}

    def lengths(
        self, position: Array, *, push: Array | None = None, offset: Array | None = None
    ) -> Array:
        """Return the equilibrium lengths, shape (B, n).

        Beyond the box, sag, tilt and softness are those of its border.

        Args:
            position: In W [m], shape (B, 3).
            push: Acceleration a for which the rest is moved by S a [m/s^2], shape (B, 3).
            offset: By how much it is moved besides [m], shape (B, 3).
        """
        return self._moved("length", position, push, offset)

    def displacement(self, position: Array, push: Array) -> Array:
        """Return the motion of the rest for a push: S a [m], shape (B, 3).

        Args:
            position: In W [m], shape (B, 3).
            push: The acceleration a [m/s^2], shape (B, 3).
        """
        return self._moved("place", position, push, None) - position

    def _moved(
        self, wanted: str, position: Array, push: Array | None, offset: Array | None
    ) -> Array:
        """Return the `place` to which rest is moved, (B, 3), or its `length`, (B, n)."""
        size = len(position)
        if np.shape(position) != (size, 3) or size == 0:
            batch("position", position, (3,))  # says what is wrong
        kept = self._kept
        if kept is None or kept[0] != size:
            kept = self._kept = (size, self._allocate(size))
        buffers = kept[1]
        with buffers.lock:
            buffers.put("target", position)
            buffers.put("push", ZERO_VECTOR if push is None else push)
            buffers.put("offset", ZERO_VECTOR if offset is None else offset)
            kernel = length_map_kernels.lengths_of_rest
            buffers.launch("lengths_of_rest", kernel, size, *self._arguments)
            return buffers.get(wanted)

    def _allocate(self, size: int) -> Buffers:
        """Allocate the buffers of the kernel, with coefficients and robot in them."""
        warp_setup.load(length_map_kernels, self._device)
        terms, n = self._extra.shape
        buffers = Buffers(self._device, {
            **dict.fromkeys(("target", "push", "offset", "place"), (size, wp.vec3d)),
            **dict.fromkeys(("exit_points", "anchor_points", "swivel_axis"), (n, wp.vec3d)),
            "pulley_radius": (n, wp.float64), "length": ((size, n), wp.float64),
            "softness": (terms, wp.mat33d), "extra": ((terms, n), wp.float64),
        })  # fmt: skip
        for name in GEOMETRY_FIELDS:
            buffers.put(name, getattr(self._robot, name))
        buffers.put("softness", self._softness)
        buffers.put("extra", self._extra)
        return buffers


def products(unit: Array) -> Array:
    """Return Chebyshev products up to the total degree, in the kernel's order, shape (B, K).

    Args:
        unit: Positions as shares of the box from its middle, shape (B, 3).
    """
    values = np.cos(np.arange(POLYNOMIAL_DEGREE + 1.0)[:, None, None] * np.arccos(unit))
    powers = np.stack(np.meshgrid(*[np.arange(POLYNOMIAL_DEGREE + 1)] * 3, indexing="ij"), -1)
    x, y, z = powers[powers.sum(axis=-1) <= POLYNOMIAL_DEGREE].T
    return np.asarray((values[x, :, 0] * values[y, :, 1] * values[z, :, 2]).T)


def softness(robot: Robot, rest: statics.Equilibrium) -> Array:
    """Return the motion of the rest per acceleration, lengths held [s^2], shape (B, 3, 3).

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
    return np.asarray(np.linalg.solve(rest.stiffness, wrench)[:, :3], dtype=np.float64)
