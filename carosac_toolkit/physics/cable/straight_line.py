r"""Straight-line kinematics: cables without weight or stretch, over pulleys if they have a radius.

This is the model most cable robots run on, and the one the sagging models are compared with. With
datum :math:`a_i`, anchor point :math:`b_i` and rotation :math:`R` held fixed,

.. math:: \ell_i(p) = r_i \theta_i + \lVert p + R b_i - P_i \rVert, \qquad
          p^* = \arg\min_p \sum_i (\ell_i(p) - L_i)^2,

where :math:`P_i` is the tangent point at wrap :math:`\theta_i`; with pulley radius 0 it is the
exit point and :math:`\theta_i = 0`. Nothing stretches, so lengths and unstrained lengths agree.

References:
    Dhakate et al., *CaRoSaC*, IEEE Robotics and Automation Letters, 2025.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from carosac_toolkit.base.arrays import Array, batch, rotations
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.physics import warp_setup
from carosac_toolkit.physics.cable import straight_line_kernels
from carosac_toolkit.physics.device import (
    check_device,
    check_rows,
    device_robot,
    kept_buffers,
)
from carosac_toolkit.physics.fleet import Fleet
from carosac_toolkit.robot.robot import Robot

GRADIENT_TOLERANCE = 1e-10  # gradient norm over the longest length that counts as converged [-]
MAX_ITERATIONS = 200


@dataclass(frozen=True, kw_only=True, eq=False)
class StraightCables:
    """The straight cables of a batch of poses.

    Attributes:
        length: Datum to anchor point, wrapped arc included [m], shape (B, n).
        wrap: Angle of contact with the pulley [rad], shape (B, n); 0 where the radius is 0.
        direction: Unit vector in W from the tangent point to the anchor point, shape (B, n, 3):
            the gradient of the length with respect to the platform's position; zero where an
            anchor point lies on its exit point.
        valid: False where the anchor point is inside the pulley and no cable exists, (B, n).
    """

    length: Array
    wrap: Array
    direction: Array
    valid: NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True, eq=False)
class StraightLineFit:
    """The positions that fit given lengths best, with their evidence.

    Attributes:
        position: Platform origin in W [m], shape (B, 3).
        rotation: The rotation from P to W that was held, shape (B, 3, 3).
        residual: Root mean square over the cables of the length error left [m], shape (B,).
        converged: True where `position` is a strict local minimum: the gradient of the squared
            error has vanished and its Hessian is positive definite, shape (B,).
        iterations: Steps tried, shape (B,).
    """

    position: Array
    rotation: Array
    residual: Array
    converged: NDArray[np.bool_]
    iterations: NDArray[np.int32]


def straight_length(
    robot: Robot | Fleet,
    position: ArrayLike,
    rotation: ArrayLike | None = None,
    *,
    device: str = "cpu",
) -> StraightCables:
    """Return straight cables at known poses, with the gradient of their lengths.

    Args:
        robot: Robot description, n cables; a `Fleet` has a robot for each row.
        position: Platform origin in W [m], shape (B, 3).
        rotation: From P to W, shape (B, 3, 3); None is the home rotation.
        device: Warp device.

    Returns:
        Lengths, wraps, gradients and whether each cable exists.
    """
    check_device(device)
    points = batch("position", position, (3,))
    check_rows(robot, "position", len(points))
    turns = _rotations(robot, rotation, len(points))
    outputs = ("length", "wrap", "direction", "valid")
    solution = _launch(
        robot,
        device,
        len(points),
        straight_line_kernels.straight_lengths,
        (len(points), robot.n),
        {"position": points, "rotation": turns},
        (device_robot(robot, device)[0], "position", "rotation", *outputs),
        outputs,
    )
    return StraightCables(
        length=solution["length"],
        wrap=solution["wrap"],
        direction=solution["direction"],
        valid=solution["valid"] != 0,
    )


def inverse_kinematics(
    robot: Robot,
    position: ArrayLike,
    rotation: ArrayLike | None = None,
    *,
    device: str = "cpu",
) -> Array:
    """Return straight-line lengths at known poses.

    Args:
        robot: Robot description, n cables.
        position: Platform origin in W [m], shape (B, 3).
        rotation: From P to W, shape (B, 3, 3); None is the home rotation.
        device: Warp device.

    Returns:
        Lengths from datum to anchor point, wrapped arcs included [m], shape (B, n).

    Raises:
        InvalidField: An anchor point lies inside its pulley, where no cable exists.
    """
    cables = straight_length(robot, position, rotation, device=device)
    if not cables.valid.all():
        row, cable = (int(i) for i in np.argwhere(~cables.valid)[0])
        raise InvalidField(
            f"position[{row}]",
            np.asarray(position)[row],
            f"positions that keep the anchor point of cable '{robot.cable_names[cable]}' "
            f"outside its pulley of radius {robot.pulley_radius[cable]} m",
        )
    return cables.length


def forward_kinematics(
    robot: Robot,
    length: ArrayLike,
    *,
    rotation: ArrayLike | None = None,
    guess: ArrayLike | None = None,
    device: str = "cpu",
) -> StraightLineFit:
    """Find positions whose straight-line lengths come closest to the target lengths.

    The squared error has several minima: where the exit points are near one plane, each solution
    below it has a twin above it. The one found is the one downhill from the guess; the default, the
    home position, finds the side on which the robot works. Where lengths are consistent the
    residual vanishes; check it where they may not be. Two cables leave a circle: on it the position
    is that in the vertical plane in which a platform hangs.

    Args:
        robot: Robot description, n cables.
        length: Cable lengths from datum to anchor point [m], shape (B, n).
        rotation: From P to W, held fixed, shape (B, 3, 3); None is the home rotation.
        guess: Initial positions [m], shape (B, 3); None is the home position.
        device: Warp device.

    Returns:
        Best-fitting positions, with residuals and `converged`; where that is False the position is
        the last iterate.
    """
    check_device(device)
    targets = batch("length", length, (robot.n,))
    turns = _rotations(robot, rotation, len(targets))
    start = robot.home_position if guess is None else batch("guess", guess, (3,))
    if guess is not None and len(start) != len(targets):
        raise InvalidField("guess", f"shape {start.shape}", f"shape {(len(targets), 3)}")
    outputs = ("position", "residual", "converged", "iterations")
    solution = _launch(
        robot,
        device,
        len(targets),
        straight_line_kernels.fit_position,
        len(targets),
        {
            "target": targets,
            "rotation": turns,
            "position": start,
            **{name: getattr(robot, name) for name in _GEOMETRY_FIELDS},
        },
        (
            "target",
            "rotation",
            *_GEOMETRY_FIELDS,
            wp.float64(GRADIENT_TOLERANCE),
            MAX_ITERATIONS,
            *outputs,
        ),
        (*outputs, "rotation"),
    )
    return StraightLineFit(
        position=solution["position"],
        rotation=solution["rotation"],
        residual=solution["residual"],
        converged=solution["converged"] != 0,
        iterations=solution["iterations"],
    )


def _launch(
    robot: Robot | Fleet, device: str, size: int, kernel: Any, dim: int | tuple[int, int],
    inputs: dict[str, Array], arguments: tuple[Any, ...], outputs: tuple[str, ...],
) -> dict[str, NDArray[Any]]:  # fmt: skip
    """Copy in, run a kernel, copy out."""
    warp_setup.load(straight_line_kernels, device)
    buffers = kept_buffers(robot, "straight_line", size, device, lambda: _shapes(size, robot.n))
    with buffers.lock:
        for name, value in inputs.items():
            buffers.put(name, value)
        buffers.launch(kernel.key, kernel, dim, *arguments)
        return {name: buffers.get(name) for name in outputs}


def _shapes(size: int, n: int) -> dict[str, tuple[Any, Any]]:
    """Return shape and type of every buffer."""
    return {
        "exit_points": (n, wp.vec3d), "anchor_points": (n, wp.vec3d),
        "pulley_radius": (n, wp.float64), "swivel_axis": (n, wp.vec3d),
        "position": (size, wp.vec3d), "rotation": (size, wp.mat33d),
        "target": ((size, n), wp.float64), "length": ((size, n), wp.float64),
        "wrap": ((size, n), wp.float64), "direction": ((size, n), wp.vec3d),
        "valid": ((size, n), wp.int32), "residual": (size, wp.float64),
        "converged": (size, wp.int32), "iterations": (size, wp.int32),
    }  # fmt: skip


_GEOMETRY_FIELDS = ("exit_points", "anchor_points", "pulley_radius", "swivel_axis")


def _rotations(robot: Robot | Fleet, rotation: ArrayLike | None, size: int) -> Array:
    """Return the home rotation, or an argument of one rotation matrix per pose."""
    return robot.home_rotation if rotation is None else rotations("rotation", rotation, size)
