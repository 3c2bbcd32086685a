r"""The prediction model: a rigid platform that n cables of given tension pull at.

Cables are straight lines that keep their length only because their tensions say so; nothing stiff
is left, so that the equations are explicit and steps of a tenth of a second are fine. Half of a
cable's weight hangs at its anchor point and a third of its mass rides with it, as of a taut cable.

State x (12): origin p in W [m]; modified Rodrigues parameters s of R = R(s) R_0; velocity v of the
origin [m/s]; angular velocity w [rad/s], in W. Input u (n): tension along each chord [N].

.. math:: \dot s = \tfrac14 \left[(1 - s^\top s) 1 - 2 [s]_\times + 2 s s^\top\right] \omega, \qquad
          J \dot\omega = \tau_c - \omega \times J \omega + J d_\omega, \qquad
          \dot v = F / m - \dot\omega \times c - \omega \times (\omega \times c) + d_v

with c from the origin to the centre of mass, F and the moment about it from cables, weight and the
air drag of the platform, and an acceleration d (6) that the observer adds for what the model does
not know, such as the air drag of cables.

References:
    Schaub, Junkins, *Analytical Mechanics of Space Systems*, AIAA, 2018, section 3.6.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.robot.robot import RigidBody, Robot, combine_bodies

STATE_SIZE = 12
PATH_QUANTITIES = 3  # kinds of quantities that limits are on: length, its rate, its acceleration


def parameter_names(n: int) -> dict[str, int]:
    """Return the size of each block of the parameter vector, in order."""
    return {
        "mass": 1, "center": 3, "inertia": 9, "inverse_inertia": 9, "weight": 1, "hang": 3,
        "drag": 1, "angular_drag": 3, "rotation": 9, "disturbance": 6,
        "exits": 3 * n, "anchors": 3 * n, "half_weight": n,
    }  # fmt: skip


def parameter_rows(n: int) -> dict[str, slice]:
    """Return where each block of the parameter vector is."""
    sizes = parameter_names(n)
    edges = np.cumsum([0, *sizes.values()]).tolist()
    return {name: slice(a, b) for name, a, b in zip(sizes, edges[:-1], edges[1:], strict=True)}


def parameters(
    robot: Robot, *, rotation: Array, length: Array, exits: Array, disturbance: Array
) -> Array:
    """Return the robot as the parameter vector of the model.

    Args:
        robot: Robot description, n cables.
        rotation: R_0, from P to W, shape (3, 3).
        length: Length of each cable, for its weight [m], shape (n,).
        exits: Where the free part of each cable begins in W [m], shape (n, 3).
        disturbance: Acceleration that is added [m/s^2, rad/s^2], in W, shape (6,).

    Returns:
        Parameter vector, blocks as `parameter_names` says, matrices column by column.
    """
    body = moving_body(robot, length)
    blocks = (
        body.mass, body.center_of_mass, body.inertia, np.linalg.inv(body.inertia),
        robot.weight, robot.center_of_mass, robot.drag,
        robot.angular_drag * robot.angular_drag_axes, rotation.T, disturbance, exits,
        robot.anchor_points, 0.5 * robot.weight_per_length,
    )  # fmt: skip
    return np.concatenate([np.ravel(block) for block in blocks])


def moving_body(robot: Robot, length: Array) -> RigidBody:
    """Combine the platform with a third of each cable (n,) [m] at its anchor point."""
    platform = RigidBody(robot.mass, robot.center_of_mass, robot.inertia)
    return combine_bodies([platform, *riding_bodies(robot, length)])


def riding_bodies(robot: Robot, length: Array) -> list[RigidBody]:
    """Return a third of each cable (n,) [m] as a point at its anchor point."""
    riding = robot.linear_density * length / 3.0
    return [
        RigidBody(float(m), b, np.zeros((3, 3)))
        for m, b in zip(riding, robot.anchor_points, strict=True)
    ]


def rotation_of(s: Array) -> Array:
    """Return the rotation matrix of modified Rodrigues parameters, shape (3,) to (3, 3)."""
    square = float(s @ s)
    cross = np.array([[0.0, -s[2], s[1]], [s[2], 0.0, -s[0]], [-s[1], s[0], 0.0]])
    turn = 8.0 * cross @ cross + 4.0 * (1.0 - square) * cross
    return np.asarray(np.eye(3) + turn / (1.0 + square) ** 2)


def parameters_of(rotation: Array) -> Array:
    """Return the modified Rodrigues parameters of a rotation matrix, |s| <= 1, shape (3,)."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_matrix(rotation).as_mrp())


@lru_cache(maxsize=8)
def continuous(n: int) -> Any:
    """Build the CasADi function (x, u, p) -> (dx/dt, its Jacobians, path, its Jacobians).

    The path is [length; rate; acceleration] of the n cables, straight and unstrained.
    """
    import casadi as ca

    x, u = ca.SX.sym("x", STATE_SIZE), ca.SX.sym("u", n)
    p = ca.SX.sym("p", sum(parameter_names(n).values()))
    block = {name: p[rows] for name, rows in parameter_rows(n).items()}
    rate, arms, forces = _motion(ca, x, u, block, n)
    path = _path(ca, x, rate, arms, block, n)
    outputs = [rate, path]
    jacobians = [ca.densify(ca.jacobian(value, wrt)) for value in outputs for wrt in (x, u)]
    names = ["rate", "rate_x", "rate_u", "path", "path_x", "path_u", "wrench"]
    values = [rate, *jacobians[:2], path, *jacobians[2:], forces]
    return ca.Function(f"motion{n}", [x, u, p], values, ["x", "u", "p"], names, {"cse": True})


def _motion(ca: Any, x: Any, u: Any, block: Any, n: int) -> tuple[Any, list[Any], Any]:
    """Return Newton-Euler rates, arms of the anchor points, and the wrench at the origin."""
    position, s, v, w = ca.vertsplit(x, 3)
    square = ca.dot(s, s)
    rotation = rotation_expression(ca, s, block["rotation"])
    up = ca.DM([0, 0, 1])
    center, hang = rotation @ block["center"], rotation @ block["hang"]
    force = -block["weight"] * up - block["drag"] * (v + ca.cross(w, hang))
    moment = ca.cross(hang, force) - rotation @ (block["angular_drag"] * (rotation.T @ w))
    exits, anchors = (ca.reshape(block[name], 3, n) for name in ("exits", "anchors"))
    arms = []
    for i in range(n):
        arm = rotation @ anchors[:, i]
        chord = exits[:, i] - position - arm
        length = ca.norm_2(chord)
        pull = u[i] * chord / length - block["half_weight"][i] * length * up
        force, moment = force + pull, moment + ca.cross(arm, pull)
        arms.append(arm)
    inertia, inverse = (ca.reshape(block[k], 3, 3) for k in ("inertia", "inverse_inertia"))
    spin = rotation @ inertia @ rotation.T @ w
    about = moment - ca.cross(center, force) - ca.cross(w, spin)
    alpha = rotation @ (inverse @ (rotation.T @ about)) + block["disturbance"][3:]
    inward = ca.cross(alpha, center) + ca.cross(w, ca.cross(w, center))
    linear = force / block["mass"] - inward + block["disturbance"][:3]
    kinematics = (1 - square) * w - 2 * ca.cross(s, w) + 2 * s * ca.dot(s, w)
    return ca.vertcat(v, kinematics / 4, linear, alpha), arms, ca.vertcat(force, moment)


def rotation_expression(ca: Any, s: Any, base: Any) -> Any:
    """Return R(s) R_0, where R_0 is given column by column (9), as an expression of CasADi."""
    cross, square = ca.skew(s), ca.dot(s, s)
    turn = 8 * cross @ cross + 4 * (1 - square) * cross
    return (ca.SX.eye(3) + turn / (1 + square) ** 2) @ ca.reshape(base, 3, 3)


def _path(ca: Any, x: Any, rate: Any, arms: list[Any], block: Any, n: int) -> Any:
    """Return length, rate and acceleration of each cable."""
    position, v, w = x[:3], x[6:9], x[9:]
    exits = ca.reshape(block["exits"], 3, n)
    lengths, rates, accelerations = [], [], []
    for i, arm in enumerate(arms):
        chord = position + arm - exits[:, i]
        length = ca.norm_2(chord)
        unit = chord / length
        velocity = v + ca.cross(w, arm)
        acceleration = rate[6:9] + ca.cross(rate[9:], arm) + ca.cross(w, ca.cross(w, arm))
        along = ca.dot(unit, velocity)
        lengths.append(length)
        rates.append(along)
        accelerations.append(
            ca.dot(unit, acceleration) + (ca.dot(velocity, velocity) - along**2) / length
        )
    return ca.vertcat(*lengths, *rates, *accelerations)


def stage(n: int) -> Any:
    """Build the function of one stage: (x, u, p, h) -> (x after h, A, B, path, its Jacobians).

    One step of the classical Runge-Kutta method of fourth order under a constant input, with the
    exact Jacobians of that step.
    """
    import casadi as ca

    f = continuous(n)
    x, u = ca.MX.sym("x", STATE_SIZE), ca.MX.sym("u", n)
    p, h = ca.MX.sym("p", f.size1_in(2)), ca.MX.sym("h")
    rate, a, b, *path = f(x, u, p)[:6]
    total, total_x, total_u = rate, a, b
    for share, weight in ((0.5, 2.0), (0.5, 2.0), (1.0, 1.0)):
        step = share * h
        rate, rate_x, rate_u = f(x + step * rate, u, p)[:3]
        a, b = rate_x + step * (rate_x @ a), rate_u + step * (rate_x @ b)
        total, total_x, total_u = (
            total + weight * rate, total_x + weight * a, total_u + weight * b,
        )  # fmt: skip
    after = x + h / 6.0 * total
    outputs = [after, ca.MX.eye(STATE_SIZE) + h / 6.0 * total_x, h / 6.0 * total_u, *path]
    names = ["after", "A", "B", "path", "path_x", "path_u"]
    dense = [ca.densify(value) for value in outputs]
    return ca.Function(f"stage{n}", [x, u, p, h], dense, ["x", "u", "p", "h"], names)


@lru_cache(maxsize=8)
def interpreted(n: int, stages: int) -> Any:
    """Map `stage` over all stages, columns side by side, for CasADi's virtual machine."""
    one = stage(n)
    return one if stages == 1 else one.map(stages)
