"""Statics of a platform on sagging cables: lengths to pose, pose to lengths, for any n.

Conventions: world frame W with z up; twists and wrenches linear first, in W, at the platform
origin; `unstrained_length` is the material between a cable's datum and its anchor point.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from carosac_toolkit.base.arrays import Array, batch, rotations
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.loop.values import Pose
from carosac_toolkit.physics import warp_setup
from carosac_toolkit.physics.cable import hanging_kernels
from carosac_toolkit.physics.cable.catenary_kernels import mat66d, vec6d
from carosac_toolkit.physics.cable.shapes import offset_from_chord
from carosac_toolkit.physics.device import (
    Buffers,
    check_call,
    check_rows,
    device_robot,
    kept_buffers,
)
from carosac_toolkit.physics.fleet import Fleet
from carosac_toolkit.physics.rest import forward_kernels, inverse_free_kernels, inverse_kernels
from carosac_toolkit.physics.rest.platform_kernels import Poses
from carosac_toolkit.physics.rest.tension_problem import (
    DISTRIBUTIONS,
    DistributionName,
    check_distribution,
)
from carosac_toolkit.robot.robot import Robot

EQUILIBRIUM_RESIDUAL_PER_WEIGHT = 1e-9  # of the weight: a larger wrench left over is no equilibrium
EQUILIBRIUM_CLOSURE_MAX = 1e-11  # of the typical cable length: a larger closure is no equilibrium
STATUS_REASONS = ("not converged", "converged", "no tensions within the limits found")


@dataclass(frozen=True, kw_only=True, eq=False)
class Equilibrium:
    """B poses of rest. Where `converged` is False the other numbers are the last attempt.

    Attributes:
        position: Platform origin in W [m], shape (B, 3).
        rotation: Rotation from P to W, shape (B, 3, 3).
        unstrained_length: Datum to anchor, at zero tension [m], shape (B, n).
        tension: At the platform [N], shape (B, n).
        residual: Norm of the wrench left over, moments divided by the largest lever arm [N], (B,).
        gap: Largest distance by which a cable misses its anchor point [m], shape (B,).
        converged: True if this is an equilibrium that meets all requirements, shape (B,).
        stable: True if it is at rest and the stiffness at constant lengths is positive definite,
            shape (B,).
        slack: True if a tension is below `tension_min`, shape (B, n).
        in_winch_range: True if a length is in the winch's range, shape (B, n); lengths are not
            limited by the solvers, which know no winches.
        stiffness: -d wrench / d (translation, rotation vector) in W at the platform origin, at
            constant lengths, shape (B, 6, 6): blocks in N/m, N, N and N m.
        exit_tension: Tension vector at the exit, pointing from platform to exit [N], (B, n, 3).
        status: Index into `STATUS_REASONS`, shape (B,).
        iterations: Newton steps, shape (B,).
    """

    position: Array
    rotation: Array
    unstrained_length: Array
    tension: Array
    residual: Array
    gap: Array
    converged: NDArray[np.bool_]
    stable: NDArray[np.bool_]
    slack: NDArray[np.bool_]
    in_winch_range: NDArray[np.bool_]
    stiffness: Array
    exit_tension: Array
    status: NDArray[np.int32]
    iterations: NDArray[np.int32]

    def rows(self, which: NDArray[np.int64]) -> Equilibrium:
        """Return some of the poses."""
        return Equilibrium(**{each.name: getattr(self, each.name)[which] for each in fields(self)})


def forward_kinematics(
    robot: Robot | Fleet,
    unstrained_length: ArrayLike,
    *,
    guess: Equilibrium | Pose | None = None,
    device: str = "cpu",
) -> Equilibrium:
    """Solve for the poses at rest on known cable lengths.

    There may be several stable equilibria. A guess is left for the one nearby, as a rule; without
    a guess the way leads downhill in energy from the robot's home pose, on straight cables first.
    After inverse kinematics pass its result as the guess.

    Args:
        robot: Robot description, n cables; a `Fleet` has a robot for each row.
        unstrained_length: [m], shape (B, n).
        guess: An earlier `Equilibrium` of the same batch (fastest), a `Pose`, or None.
        device: Warp device.

    Returns:
        The equilibria; nothing is clipped, and a slack cable is reported, no error.

    Raises:
        InvalidField: A wrong shape, a length that is not finite and positive, or a guess of
            another batch size.
    """
    check_call(robot, device)
    length = batch("unstrained_length", unstrained_length, (robot.n,))
    if (length <= 0.0).any():
        b, i = (int(k) for k in np.argwhere(length <= 0.0)[0])
        raise InvalidField(f"unstrained_length[{b}, {i}]", f"{length[b, i]} m", "> 0 m")
    size = len(length)
    check_rows(robot, "unstrained_length", size)
    _check_guess(guess, size, robot)
    warp_setup.load(forward_kernels, device)
    cables, bodies = device_robot(robot, device)
    buffers = kept_buffers(robot, "statics", size, device, lambda: _shapes(size, robot.n))
    with buffers.lock:
        buffers.put("unstrained_length", length)
        warm = _put_guess(robot, buffers, guess)
        buffers.launch(
            f"forward{warm}", forward_kernels.forward, size, cables, bodies, warm,
            Poses,
        )  # fmt: skip
        return _equilibrium(robot, buffers)


def inverse_kinematics(
    robot: Robot | Fleet,
    position: ArrayLike,
    rotation: ArrayLike | None = None,
    *,
    guess: Equilibrium | Pose | None = None,
    distribution: DistributionName = "least_squares",
    device: str = "cpu",
) -> Equilibrium:
    """Solve for cable lengths and tensions that hold the platform origin at rest.

    With n >= 6 cables the rotation is held and the tensions are chosen within ``[tension_min,
    tension_max]``; with n > 6 there is a choice, by `distribution`. With n < 6 the rotation is
    free: among the statically stable equilibria near the guess, the one with the least squared
    tensions within the limits.

    Args:
        robot: Robot description, n cables; a `Fleet` has a robot for each row.
        position: Platform origin in W [m], shape (B, 3).
        rotation: Rotation from P to W, shape (B, 3, 3); None is the home rotation. With n < 6 it
            must be None.
        guess: Start of the search for a free rotation; unused with n >= 6.
        distribution: Which tensions, see `tension_distribution`; with n < 6 there is no choice,
            and only the default is allowed.
        device: Warp device.

    Returns:
        The equilibria. Where no tensions within the limits were found `converged` is False and
        `status` says so; nothing is clipped.

    Raises:
        InvalidField: A wrong shape, numbers that are not finite, or a rotation or another
            distribution for n < 6.
    """
    check_call(robot, device)
    check_distribution(distribution, robot.n)
    where = batch("position", position, (3,))
    size = len(where)
    check_rows(robot, "position", size)
    free = robot.n < 6
    if free and rotation is not None:
        raise InvalidField("rotation", "a rotation", f"None: {robot.n} cables leave it free")
    _check_guess(guess, size, robot)
    held = _held_rotation(robot, rotation if not free else None, size)
    warp_setup.load(inverse_kernels, device)
    if free:
        warp_setup.load(inverse_free_kernels, device)
    buffers = kept_buffers(robot, "statics", size, device, lambda: _shapes(size, robot.n))
    with buffers.lock:
        buffers.put("position", where)
        buffers.put("rotation", guess.rotation if free and guess is not None else held)
        _launch_inverse(robot, buffers, size, free, DISTRIBUTIONS.index(distribution), device)
        return _equilibrium(robot, buffers)


def _launch_inverse(
    robot: Robot | Fleet, buffers: Buffers, size: int, free: bool, choice: int, device: str
) -> None:
    """Solve, then judge the answer by its lengths alone."""
    robots = device_robot(robot, device)
    if free:
        buffers.launch("free", inverse_free_kernels.inverse_free, size, *robots, Poses)
    else:
        buffers.launch(f"held{choice}", inverse_kernels.inverse_held, size, *robots, choice, Poses)
    buffers.launch("evaluate", inverse_kernels.evaluate, size, *robots, Poses)


def cable_shape(
    robot: Robot, equilibrium: Equilibrium, samples: int = 24, *, device: str = "cpu"
) -> Array:
    """Return points along the free part of each hanging cable.

    Args:
        robot: Robot description, n cables.
        equilibrium: B equilibria of this robot.
        samples: Points per cable, at least 2, evenly spaced in unstrained length.
        device: Warp device.

    Returns:
        Points in W [m], shape (B, n, samples, 3): tangent point first, anchor point last.
    """
    if samples < 2:
        raise InvalidField("samples", samples, "samples >= 2")
    warp_setup.load(hanging_kernels, device)
    cables, _ = device_robot(robot, device)
    shape = equilibrium.unstrained_length.shape
    points = wp.zeros((*shape, samples), dtype=wp.vec3d, device=device)
    inputs = [
        cables,
        wp.array(equilibrium.unstrained_length, dtype=wp.float64, device=device),
        wp.array(equilibrium.exit_tension, dtype=wp.vec3d, device=device),
        points,
    ]
    wp.launch(hanging_kernels.cable_points, shape, inputs=inputs, device=device)
    shapes: Array = points.numpy()
    return shapes


def sag(robot: Robot, equilibrium: Equilibrium, *, samples: int = 101) -> Array:
    """Return the largest distance of each free cable from its chord [m], shape (B, n)."""
    points = cable_shape(robot, equilibrium, samples)
    distance: Array = np.linalg.norm(offset_from_chord(points), axis=-1).max(axis=-1)
    return distance


def _check_guess(guess: Equilibrium | Pose | None, size: int, robot: Robot | Fleet) -> None:
    """Refuse a guess of another kind, batch size or robot."""
    if guess is None:
        return
    if not isinstance(guess, Equilibrium | Pose):
        raise InvalidField("guess", type(guess).__name__, "an Equilibrium, a Pose or None")
    if not np.isfinite(guess.position.sum() + guess.rotation.sum()):
        raise InvalidField("guess", "numbers that are not finite", "a finite pose")
    if len(guess.position) != size:
        raise InvalidField("guess", f"{len(guess.position)} poses", f"{size}, as the batch")
    if isinstance(guess, Equilibrium) and guess.exit_tension.shape[1] != robot.n:
        raise InvalidField("guess", f"{guess.exit_tension.shape[1]} cables", f"{robot.n} cables")


def _put_guess(robot: Robot | Fleet, buffers: Buffers, guess: Equilibrium | Pose | None) -> int:
    """Fill in the start; 0: home, 1: a pose, 2: a pose with tension vectors."""
    if guess is None:
        buffers.put("position", robot.home_position)
        buffers.put("rotation", robot.home_rotation)
        return 0
    buffers.put("position", guess.position)
    buffers.put("rotation", guess.rotation)
    if isinstance(guess, Pose):
        return 1
    buffers.put("q", guess.exit_tension)
    return 2


def _held_rotation(robot: Robot | Fleet, rotation: ArrayLike | None, size: int) -> Array:
    """Return the rotation to hold; refuse one for fewer than six cables."""
    if rotation is None:
        return np.broadcast_to(robot.home_rotation, (size, 3, 3))
    return rotations("rotation", rotation, size)


def _shapes(size: int, n: int) -> dict[str, tuple[Any, Any]]:
    """Return shape and type of every buffer of a batch."""
    per_cable = (size, n)
    return {
        "position": (size, wp.vec3d), "rotation": (size, wp.mat33d), "stiffness": (size, mat66d),
        "residual": (size, wp.float64), "closure": (size, wp.float64), "status": (size, int),
        "stable": (size, int), "steps": (size, int),
        "unstrained_length": (per_cable, wp.float64), "tension": (per_cable, wp.float64),
        "q": (per_cable, wp.vec3d), "inverse": (per_cable, wp.mat33d),
        "wanted": (per_cable, wp.float64), "lower": (per_cable, wp.float64),
        "upper": (per_cable, wp.float64), "middle": (per_cable, wp.float64),
        "softness": (per_cable, wp.float64), "reference": (per_cable, wp.float64),
        "scale": (per_cable, wp.float64), "iterate": (per_cable, wp.float64),
        "column": (per_cable, vec6d), "twist": (per_cable, wp.vec3d), "bound": (per_cable, int),
    }  # fmt: skip


def _equilibrium(robot: Robot | Fleet, buffers: Buffers) -> Equilibrium:
    """Copy the answer out and judge it."""
    tension = buffers.get("tension")
    length = buffers.get("unstrained_length")
    residual, gap, status = (buffers.get(k) for k in ("residual", "closure", "status"))
    sound = (residual <= EQUILIBRIUM_RESIDUAL_PER_WEIGHT * robot.weight) & (
        gap <= EQUILIBRIUM_CLOSURE_MAX * buffers.length_scale
    )
    converged = (status == 1) & sound
    return Equilibrium(
        position=buffers.get("position"),
        rotation=buffers.get("rotation"),
        unstrained_length=length,
        tension=tension,
        residual=residual,
        gap=gap,
        converged=converged,
        stable=(buffers.get("stable") == 1) & sound,
        slack=tension < robot.tension_min * (1.0 - 1e-9),
        in_winch_range=(length >= robot.length_min) & (length <= robot.length_max),
        stiffness=buffers.get("stiffness"),
        exit_tension=buffers.get("q"),
        status=np.where(converged, 1, np.where(status == 1, 0, status)).astype(np.int32),
        iterations=buffers.get("steps"),
    )
