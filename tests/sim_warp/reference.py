"""Independent oracles for simulators: numpy, scipy and pin, with the cables of `tests.reference`.

The exact answers that a simulated robot must approach: how it swings a little, where a chain of
point masses rests, how a free body tumbles, and how a platform moves on cables without inertia.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.integrate import solve_ivp
from scipy.linalg import eigh
from scipy.optimize import root
from scipy.spatial.transform import Rotation

import carosac_toolkit as ct
from carosac_toolkit.physics.rest.statics import Equilibrium
from carosac_toolkit.robot.robot import Robot
from tests import reference
from tests.physics.rest.test_modes import difference_of_wrench

Array = NDArray[Any]
UP = np.array([0.0, 0.0, 1.0])


# --- Small motions -----------------------------------------------------------------------------


def linear_modes(
    robot: Robot, equilibrium: Equilibrium, *, cable_mass: bool = False
) -> tuple[Array, Array]:
    """Natural frequencies of a platform on quasi-static cables, of constant lengths.

    Stiffness by finite differences of the independent cable equations, mass by pin.

    Args:
        robot: Robot description, n cables.
        equilibrium: One pose of rest (B = 1) of this robot.
        cable_mass: Whether a third of each cable's mass rides at its anchor point.

    Returns:
        Frequencies [Hz], slowest first, shape (6,), and the twists of the modes (linear first, in
        W, at the platform origin) as columns, shape (6, 6), of unit modal mass.
    """
    rotation = equilibrium.rotation[0]
    mass = reference.mass_matrix(robot, rotation)
    if cable_mass:
        for arm, extra in zip(*_riders(robot, equilibrium.unstrained_length[0]), strict=True):
            reach = np.hstack([np.eye(3), -_cross(rotation @ arm)])
            mass = mass + extra * reach.T @ reach
    values, shapes = eigh(difference_of_wrench(robot, equilibrium), mass)
    return np.sign(values) * np.sqrt(np.abs(values)) / (2.0 * np.pi), shapes


# --- Chains of point masses --------------------------------------------------------------------


class StringEquilibrium(NamedTuple):
    """A platform at rest on chains of point masses.

    Attributes:
        position: Platform origin in W [m], shape (3,).
        rotation: Rotation from P to W, shape (3, 3).
        nodes: From exit to anchor in W [m], shape (n, N + 1, 3).
        tension: Of each segment, from exit to anchor [N], shape (n, N).
        force: Of each cable on the platform, the weight of its half segment in it [N], (n, 3).
        residual: Largest residual: closure [m], balance over the weight [-, m].
    """

    position: Array
    rotation: Array
    nodes: Array
    tension: Array
    force: Array
    residual: float


def segment_shares(segments: int) -> Array:
    """Lengths of the segments over L / N: the weights of the end-corrected midpoint rule."""
    shares = np.ones(segments)
    if segments >= 6:
        ends = np.array([13 / 12, 7 / 8, 25 / 24])
        shares[:3], shares[-3:] = ends, ends[::-1]
    return shares


def string_equilibrium(
    robot: Robot, unstrained_length: ArrayLike, segments: int
) -> StringEquilibrium:
    """Rest of a platform on cables of N springs and N - 1 point masses.

    Each segment holds its share of L (`segment_shares`), and is 1 + T / EA times as long; each node
    has the mass of L / N, and half of that hangs on the platform at the anchor. The
    `run_length` behind the exit is stretched by the tension there, e = (T + half the weight of the
    first segment along it) / EA, and the first segment is longer by run e. It is as heavy as L / N
    and the run T / EA / (1 + T / EA) of material that so passes the exit.

    Unknowns are the pose and the forces at the anchors; each cable is marched from there to the
    exit. The start is our own statics, which decides only which rest is found.

    Args:
        robot: Robot description with eyelets, n cables.
        unstrained_length: Datum to anchor [m], shape (n,).
        segments: N per cable.
    """
    assert not robot.pulley_radius.any(), "a chain over a pulley has no closed form here"
    length = np.asarray(unstrained_length, dtype=np.float64)
    start = ct.statics.forward_kinematics(robot, length[None])
    assert start.converged[0], "no rest to start from"
    base, scale = start.rotation[0], robot.weight / robot.n
    force = start.exit_tension[0] - np.outer(robot.weight_per_length * length, UP)

    def residual(x: Array) -> Array:
        arm = robot.anchor_points @ _turn(x[3:6], base).T
        pull = x[6:].reshape(-1, 3) * scale
        nodes, _ = _march(robot, length, segments, x[:3] + arm, pull)
        weight = -robot.weight * UP
        center = _turn(x[3:6], base) @ robot.center_of_mass
        moment = np.cross(arm, pull).sum(axis=0) + np.cross(center, weight)
        balance = np.concatenate([pull.sum(axis=0) + weight, moment]) / robot.weight
        return np.concatenate([(nodes[:, 0] - robot.exit_points).ravel(), balance])

    x = np.concatenate([start.position[0], np.zeros(3), (force / scale).ravel()])
    x = root(residual, x, tol=1e-13).x
    for _ in range(3):  # Newton, its Jacobian by central differences
        x = x - np.linalg.solve(_jacobian(residual, x), residual(x))
    rotation, pull = _turn(x[3:6], base), x[6:].reshape(-1, 3) * scale
    arm = robot.anchor_points @ rotation.T
    nodes, tension = _march(robot, length, segments, x[:3] + arm, pull)
    miss = float(np.abs(residual(x)).max())
    return StringEquilibrium(x[:3], rotation, nodes, tension, pull, miss)


def _march(
    robot: Robot, length: Array, segments: int, anchor: Array, force: Array
) -> tuple[Array, Array]:
    """Nodes (n, N + 1, 3) [m] and tensions (n, N) [N] that follow from forces at the anchors."""
    piece = length / segments
    shares = segment_shares(segments)
    weight = np.outer(robot.weight_per_length * piece, UP)
    pull = force + weight / 2.0
    nodes, tensions = [anchor], []
    for share in shares[:0:-1]:
        tension = np.linalg.norm(pull, axis=1)
        reach = share * piece * (1.0 + tension / robot.axial_stiffness)
        nodes.append(nodes[-1] + (reach / tension)[:, None] * pull)
        tensions.append(tension)
        pull = pull + weight
    below, run, extra = pull, robot.run_length, np.zeros(robot.n)
    for _ in range(4):  # the bit from the run weighs next to nothing: a contraction
        pull = below + np.outer(robot.weight_per_length * extra / 2.0, UP)
        tension = np.linalg.norm(pull, axis=1)
        strain = tension / robot.axial_stiffness
        extra = run * strain / (1.0 + strain)
    half = robot.weight_per_length * (piece + extra) / 2.0 * pull[:, 2] / tension
    reach = shares[0] * piece * (1.0 + strain) + run * (strain + half / robot.axial_stiffness)
    nodes.append(nodes[-1] + (reach / tension)[:, None] * pull)
    tensions.append(tension)
    return np.stack(nodes[::-1], axis=1), np.stack(tensions[::-1], axis=1)


def _jacobian(function: Callable[[Array], Array], x: Array, step: float = 1e-6) -> Array:
    """Central differences, shape (m, len(x))."""
    steps = step * np.eye(len(x))
    return np.stack([(function(x + h) - function(x - h)) / (2.0 * step) for h in steps], axis=1)


# --- Motion of the platform --------------------------------------------------------------------


class Motion(NamedTuple):
    """A platform in motion at K times.

    Attributes:
        time: [s], shape (K,).
        position: Platform origin in W [m], shape (K, 3).
        rotation: Rotation from P to W, shape (K, 3, 3).
        twist: Linear first, in W, at the platform origin [m/s, rad/s], shape (K, 6).
        tension: Of the cables at the platform [N], shape (K, n); 0 where there are none.
    """

    time: Array
    position: Array
    rotation: Array
    twist: Array
    tension: Array


def free_flight(
    robot: Robot,
    position: ArrayLike,
    rotation: ArrayLike,
    twist: ArrayLike,
    duration: float,
    *,
    times: Sequence[float] | None = None,
) -> Motion:
    """The platform without cables, under gravity alone.

    Args:
        robot: Robot description; its drag is left out.
        position: Platform origin in W [m], shape (3,).
        rotation: Rotation from P to W, shape (3, 3).
        twist: Linear first, in W, at the platform origin [m/s, rad/s], shape (6,).
        duration: [s].
        times: When to report [s]; None is the end alone.
    """
    body = _Body(robot)
    start = body.state(position, rotation, twist)
    states, when = _integrate(
        lambda t, x: body.derivative(x, np.zeros(6)), start, duration, times, 1e-12
    )
    return body.motion(when, states, np.zeros((len(when), robot.n)))


def dynamics_oracle(
    robot: Robot,
    unstrained_length: Callable[[float], ArrayLike] | ArrayLike,
    position: ArrayLike,
    rotation: ArrayLike,
    twist: ArrayLike,
    duration: float,
    *,
    times: Sequence[float] | None = None,
    cable_mass: bool = False,
    rtol: float = 1e-9,
) -> Motion:
    """A rigid platform on cables that hang at every moment as if at rest (no axial damping).

    Drag is `robot.drag` against the velocity of the centre of mass, there, and
    `robot.angular_drag` against the angular velocity, times `robot.angular_drag_axes` about the
    axes of P. With `cable_mass` a third of the mass of
    each cable, rho L(t) / 3, rides at its anchor point, without weight: that is in the cable.

    Args:
        robot: Robot description, n cables.
        unstrained_length: [m], shape (n,), or a function of time [s]; smooth, or accuracy suffers.
        position: Platform origin in W [m], shape (3,).
        rotation: Rotation from P to W, shape (3, 3).
        twist: Linear first, in W, at the platform origin [m/s, rad/s], shape (6,).
        duration: [s].
        times: When to report [s]; None is the end alone.
        cable_mass: Whether part of the cables' mass rides along.
        rtol: Relative tolerance of the integration.
    """
    fixed = None if callable(unstrained_length) else np.asarray(unstrained_length, dtype=float)

    def length(t: float) -> Array:
        return fixed if fixed is not None else np.asarray(unstrained_length(t), dtype=float)

    body, cables = _Body(robot), HangingCables(robot)

    def pull(t: float, x: Array, turn: Array) -> tuple[Array, Array]:
        arm = robot.anchor_points @ turn.T
        return cables.force(length(t), x[:3] + arm), arm

    def derivative(t: float, x: Array) -> Array:
        turn = body.rotation(x)
        force, arm = pull(t, x, turn)
        omega, center = turn @ x[10:13], turn @ robot.center_of_mass
        air = -robot.drag * (turn @ x[7:10] + np.cross(omega, center))
        if cable_mass:
            riders = _riders(robot, length(t))
            body.carry(*riders)
            force = force + np.outer(riders[1] * robot.gravity, UP)
        moment = np.cross(arm, force).sum(axis=0) + np.cross(center, air)
        turning = robot.angular_drag * turn @ (robot.angular_drag_axes * x[10:13])
        total = np.concatenate([force.sum(axis=0) + air, moment - turning])
        return body.derivative(x, total)

    start = body.state(position, rotation, twist)
    states, when = _integrate(derivative, start, duration, times, rtol)
    forces = [pull(t, x, body.rotation(x))[0] for t, x in zip(when, states, strict=True)]
    return body.motion(when, states, np.linalg.norm(forces, axis=2))


class HangingCables:
    """Exact elastic catenaries at rest, closed again and again from the last forces.

    Newton on `reference.cable_closure`, with the slope kept as long as it converges.
    """

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        self._force: Array | None = None
        self._inverse = np.zeros((robot.n, 3, 3))

    def force(self, unstrained_length: Array, anchor: Array, *, tolerance: float = 1e-13) -> Array:
        """Of each cable on the platform [N], shape (n, 3).

        Args:
            unstrained_length: [m], shape (n,).
            anchor: Anchor points in W [m], shape (n, 3).
            tolerance: Of the closure [m]; 100 times that will do where rounding, which grows
                with one over the weight of the cables, forbids more.
        """
        if self._force is None:
            self._force = self._first(unstrained_length, anchor)
            self._refresh(unstrained_length, anchor)
        last = np.inf
        for step in range(60):
            gap = reference.cable_closure(self.robot, unstrained_length, anchor, self._force)
            size = float(np.abs(gap).max())
            if size < tolerance or (size > last / 2.0 and size < 100.0 * tolerance):
                return np.asarray(self._force, dtype=np.float64)
            if step and size > 0.05 * last:
                self._refresh(unstrained_length, anchor)
            change = np.einsum("nij,nj->ni", self._inverse, gap.astype(np.float64))
            largest = np.linalg.norm(change, axis=1) / np.linalg.norm(self._force, axis=1)
            shrink = 1.0 / np.maximum(1.0, largest.astype(np.float64) / 0.5)
            self._force, last = self._force - shrink[:, None] * change, size
        raise ArithmeticError(f"cables still miss by {size} m")

    def _refresh(self, unstrained_length: Array, anchor: Array) -> None:
        """The inverse of d closure / d force, by central differences."""
        steps = 1e-4 * np.eye(3)[:, None, :]
        ends = np.stack([self._force + steps, self._force - steps])
        ahead, behind = reference.cable_closure(self.robot, unstrained_length, anchor, ends)
        slope = ((ahead - behind) / 2e-4).astype(np.float64).transpose(1, 2, 0)
        self._inverse = np.linalg.inv(slope)

    def _first(self, unstrained_length: Array, anchor: Array) -> Array:
        """Each cable alone between anchor and datum, softened by its run."""
        robot, chord = self.robot, self.robot.exit_points - anchor
        force = np.empty((robot.n, 3), dtype=np.longdouble)
        for i in range(robot.n):
            flat, size = max(np.hypot(*chord[i, :2]), 1e-6), unstrained_length[i]
            soft = robot.axial_stiffness[i] * size / (size + robot.run_length[i])
            h, v = reference.catenary(
                flat, chord[i, 2], size, robot.weight_per_length[i], float(soft)
            )
            force[i] = [*(h * chord[i, :2] / flat), v]
        return force


class _Body:
    """The platform as pin's free flyer; states: position, quaternion (x, y, z, w), twist in P."""

    def __init__(self, robot: Robot) -> None:
        import pinocchio as pin

        self._pin = pin
        self.robot = robot
        self.model = pin.Model()
        self.model.gravity.linear = -robot.gravity * UP
        joint = self.model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "platform")
        center, inertia = np.array(robot.center_of_mass), np.array(robot.inertia)
        self.inertia = pin.Inertia(robot.mass, center, inertia)
        self.model.appendBodyToJoint(joint, self.inertia, pin.SE3.Identity())
        self.data = self.model.createData()

    def carry(self, arms: Array, masses: Array) -> None:
        """Point masses [kg], shape (n,), ride at points of the platform [m], shape (n, 3)."""
        total = self.inertia.copy()
        for arm, mass in zip(arms, masses, strict=True):
            total += self._pin.Inertia(float(mass), np.array(arm), np.zeros((3, 3)))
        self.model.inertias[1] = total

    def state(self, position: ArrayLike, rotation: ArrayLike, twist: ArrayLike) -> Array:
        """State vector of a pose and its twist in W, shape (13,)."""
        turn, speed = np.asarray(rotation, dtype=float), np.asarray(twist, dtype=float)
        quaternion = Rotation.from_matrix(turn).as_quat()
        local = [turn.T @ speed[:3], turn.T @ speed[3:]]
        return np.concatenate([np.asarray(position, dtype=float), quaternion, *local])

    @staticmethod
    def rotation(x: Array) -> Array:
        """From P to W, shape (3, 3)."""
        a, b, c, d = x[3:7] * np.sqrt(2.0 / (x[3:7] @ x[3:7]))
        return np.array(
            [
                [1.0 - b * b - c * c, a * b - c * d, a * c + b * d],
                [a * b + c * d, 1.0 - a * a - c * c, b * c - a * d],
                [a * c - b * d, b * c + a * d, 1.0 - a * a - b * b],
            ]
        )

    def derivative(self, x: Array, wrench: Array) -> Array:
        """Of the state, under a wrench [N, N m] in W at the platform origin, shape (6,)."""
        turn = self.rotation(x)
        q = np.concatenate([x[:3], x[3:7] / np.linalg.norm(x[3:7])])
        local = np.concatenate([turn.T @ wrench[:3], turn.T @ wrench[3:]])
        acceleration = self._pin.aba(self.model, self.data, q, x[7:], local)
        imaginary, real, omega = x[3:6], x[6], x[10:13]
        spin = np.append(real * omega + np.cross(imaginary, omega), -imaginary @ omega) / 2.0
        return np.concatenate([turn @ x[7:10], spin, acceleration])

    def motion(self, time: Array, states: Array, tension: Array) -> Motion:
        """States as a motion in W."""
        turn = np.array([self.rotation(x) for x in states])
        linear = np.einsum("kij,kj->ki", turn, states[:, 7:10])
        angular = np.einsum("kij,kj->ki", turn, states[:, 10:13])
        return Motion(time, states[:, :3], turn, np.hstack([linear, angular]), tension)


def _integrate(
    derivative: Callable[[float, Array], Array],
    start: Array,
    duration: float,
    times: Sequence[float] | None,
    rtol: float,
) -> tuple[Array, Array]:
    """States at the times asked for, shape (K, 13), and these times [s]."""
    when = np.array([duration]) if times is None else np.asarray(times, dtype=np.float64)
    found = solve_ivp(
        derivative, (0.0, duration), start, "DOP853", t_eval=when, rtol=rtol, atol=rtol * 1e-1
    )
    assert found.success, found.message
    return found.y.T, when


def _riders(robot: Robot, length: Array) -> tuple[Array, Array]:
    """Where a third of each cable's mass rides, in P [m], and that mass [kg]."""
    return robot.anchor_points, robot.linear_density * length / 3.0


def _turn(vector: Array, base: Array) -> Array:
    """Rotation by a vector in W after `base`."""
    return np.asarray(Rotation.from_rotvec(vector).as_matrix() @ base)


def _cross(v: Array) -> Array:
    """The matrix of v x."""
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
