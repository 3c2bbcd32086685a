"""Positions of rest nearest to wanted ones: two cables hold a platform on a surface only."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from carosac_toolkit.base.arrays import Array, batch
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.loop.values import Pose
from carosac_toolkit.physics.device import robots_of
from carosac_toolkit.physics.fleet import Fleet
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.physics.rest.statics import Equilibrium
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.robot.sizes import SURFACE_CABLES, cable_size

LENGTH_STEP_SHARE = 1e-5  # of the length: step of the differences
STEP_MAX_SHARE = 0.1  # of the length: longest step of a cable
CLOSE_SHARE = 1e-10  # of the length: a shorter step is the last one
STEPS_MAX = 30
PLANE_SHARE = 1e-8  # of the cable length: positions of rest nearer than this to a plane are on it


@dataclass(frozen=True, kw_only=True, eq=False)
class NearestRest:
    """Rest at the positions nearest to wanted ones.

    Attributes:
        equilibrium: B equilibria; `converged` is False if none was found.
        distance: From the wanted position to the one of rest [m], shape (B,).
    """

    equilibrium: Equilibrium
    distance: Array


def nearest_rest(
    robot: Robot | Fleet,
    position: ArrayLike,
    *,
    guess: Equilibrium | Pose | None = None,
    device: str = "cpu",
) -> NearestRest:
    """Find the position of rest nearest to each wanted position.

    Gauss-Newton over the cable lengths, which stay free: with n < 3 cables the positions of rest
    form a surface (n = 2) or a line. Tension limits are judged by the result's `slack`.

    Args:
        robot: Robot description, n cables; a `Fleet` has a robot for each row.
        position: Wanted platform origin in W [m], shape (B, 3).
        guess: Start of the first forward kinematics.
        device: Warp device.

    Returns:
        The equilibria and how far they are from what was wanted.
    """
    wanted = batch("position", position, (3,))
    robots = robots_of(robot)
    exits = np.stack([one.exit_points for one in robots])
    arms = np.stack([one.anchor_points @ one.home_rotation.T for one in robots])
    length = np.linalg.norm(exits - arms - wanted[:, None], axis=-1)
    rest = statics.forward_kinematics(robot, length, guess=guess, device=device)
    for _step in range(STEPS_MAX):
        step = _step_towards(robot, rest, wanted, device)
        limit = STEP_MAX_SHARE * rest.unstrained_length
        step /= np.maximum(1.0, np.abs(step) / limit).max(axis=1, keepdims=True)
        length = rest.unstrained_length + step
        rest = statics.forward_kinematics(robot, length, guess=rest, device=device)
        if (np.abs(step) <= CLOSE_SHARE * rest.unstrained_length).all():
            break
    return NearestRest(equilibrium=rest, distance=np.linalg.norm(rest.position - wanted, axis=1))


def rest_at(
    robot: Robot | Fleet,
    position: ArrayLike,
    rotation: ArrayLike | None = None,
    *,
    device: str = "cpu",
) -> Equilibrium:
    """Return the equilibria of inverse kinematics, with two cables the nearest ones.

    For the start of a simulation: a plant of two cables rests on another surface than its nominal
    robot, so that it never rests exactly where the nominal one does.
    """
    if robot.n != SURFACE_CABLES or rotation is not None:
        return statics.inverse_kinematics(robot, position, rotation, device=device)
    return nearest_rest(robot, position, device=device).equilibrium


def plane_of_rest(robot: Robot, position: Array) -> tuple[Array, Array]:
    """Return the vertical plane in which two cables hold a platform: that of cables and weight.

    Args:
        robot: Robot description, n = 2.
        position: Positions of rest in W [m], shape (B, 3).

    Returns:
        Horizontal unit normal in W, shape (3,), and a point of the plane in W [m], shape (3,).

    Raises:
        InvalidField: One exit point is above the other, so that the platform turns freely, or
            swivel axes are so inclined that the positions of rest are no plane.
    """
    apart = robot.exit_points[1] - robot.exit_points[0]
    across = np.array([-apart[1], apart[0], 0.0])
    width, size = float(np.linalg.norm(across)), cable_size(robot)
    if width <= PLANE_SHARE * size:
        points = f"{robot.exit_points[0]} and {robot.exit_points[1]} m"
        raise InvalidField("exit_points", points, "not one above the other, with two cables")
    normal, point = across / width, position.mean(axis=0)
    error = float(np.abs((position - point) @ normal).max())
    if error > PLANE_SHARE * size:
        allowed = (
            "upright, or in the vertical plane of the exit points, so that the positions of rest "
            "with two cables are a plane"
        )
        raise InvalidField("swivel_axis", f"positions of rest {error:.2g} m off a plane", allowed)
    return normal, point


def _step_towards(robot: Robot | Fleet, rest: Equilibrium, wanted: Array, device: str) -> Array:
    """Return the change of lengths that moves the rest towards the wanted positions, (B, n)."""
    length = rest.unstrained_length
    h = LENGTH_STEP_SHARE * length.mean(axis=1, keepdims=True)
    slopes = []
    for cable in np.eye(length.shape[1]):
        ends = [
            statics.forward_kinematics(robot, length + sign * h * cable, guess=rest, device=device)
            for sign in (1.0, -1.0)
        ]
        slopes.append((ends[0].position - ends[1].position) / (2.0 * h))
    step = np.linalg.pinv(np.stack(slopes, axis=2)) @ (wanted - rest.position)[:, :, None]
    return np.asarray(step[:, :, 0])
