"""Independent reference solutions for tests: numpy, scipy, osqp and pin, none of our physics.

Everything here favours certainty over speed: nested bracketing instead of a clever start, extended
precision (80-bit where numpy has it) for residuals, finite differences for Jacobians.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq, least_squares, nnls
from scipy.spatial.transform import Rotation

from carosac_toolkit.robot.robot import Robot

Array = NDArray[Any]
LONG = np.longdouble


# --- One cable: Irvine's closed form -----------------------------------------------------------


def catenary_ends(
    horizontal: Any, vertical: Any, length: Any, weight: Any, stiffness: Any
) -> tuple[Any, Any]:
    """Span and rise [m] of an elastic catenary with H > 0 and V [N] at its lower end.

    Irvine, *Cable Structures*, 1981, eq. (2.25)-(2.26), written from the lower end upwards.
    """
    upper = vertical + weight * length
    sines = np.arcsinh(upper / horizontal) - np.arcsinh(vertical / horizontal)
    span = horizontal * length / stiffness + horizontal / weight * sines
    tensions = np.hypot(horizontal, upper) - np.hypot(horizontal, vertical)
    rise = tensions / weight + (weight * length / 2 + vertical) * length / stiffness
    return span, rise


def catenary(
    span: float, rise: float, length: float, weight: float, stiffness: float
) -> tuple[float, float]:
    """Horizontal tension and vertical tension at the lower end [N].

    Both equations are monotonic: rise in V at fixed H, and span in H along the V that keeps the
    rise. So nested bracketing finds the only solution; Newton in extended precision polishes it.

    Args:
        span: Horizontal distance of the ends [m], > 0.
        rise: Height of the upper end over the lower one [m]; may be negative.
        length: Unstrained length [m].
        weight: Per unstrained length [N/m].
        stiffness: EA [N].
    """
    total = weight * length

    def vertical(horizontal: float) -> float:
        def miss(v: float) -> float:
            return float(catenary_ends(horizontal, v, length, weight, stiffness)[1] - rise)

        reach = total
        while miss(-total - reach) > 0.0 or miss(reach) < 0.0:
            reach *= 4.0
        return float(brentq(miss, -total - reach, reach, xtol=1e-300, rtol=1e-15))

    def miss(log_horizontal: float) -> float:
        h = float(np.exp(log_horizontal))
        return float(catenary_ends(h, vertical(h), length, weight, stiffness)[0] - span)

    low = high = float(np.log(total))
    while miss(low) > 0.0:
        low -= 3.0
    while miss(high) < 0.0:
        high += 3.0
    start = float(np.exp(brentq(miss, low, high, xtol=1e-14, rtol=1e-15)))
    return _polish_catenary(start, vertical(start), span, rise, length, weight, stiffness)


def _polish_catenary(
    h: float, v: float, span: float, rise: float, length: float, weight: float, stiffness: float
) -> tuple[float, float]:
    """Newton steps with extended-precision residuals and the analytic compliance."""
    x = np.array([h, v], dtype=LONG)
    goal = np.array([span, rise], dtype=LONG)
    size, w, ea = LONG(length), LONG(weight), LONG(stiffness)
    for _ in range(6):
        upper = x[1] + w * size
        ta, tb = np.hypot(x[0], upper), np.hypot(x[0], x[1])
        sines = np.arcsinh(upper / x[0]) - np.arcsinh(x[1] / x[0])
        c11 = size / ea + (sines - (upper / ta - x[1] / tb)) / w
        c12 = x[0] / w * (1 / ta - 1 / tb)
        c22 = size / ea + (upper / ta - x[1] / tb) / w
        miss = goal - np.array(catenary_ends(x[0], x[1], size, w, ea))
        det = c11 * c22 - c12 * c12
        x = x + np.array([c22 * miss[0] - c12 * miss[1], c11 * miss[1] - c12 * miss[0]]) / det
    return float(x[0]), float(x[1])


# --- A platform at rest ------------------------------------------------------------------------


class ReferenceEquilibrium(NamedTuple):
    """Pose, tension at the platform [N] and the largest residual, relative to weight and 1 m."""

    position: Array
    rotation: Array
    tension: Array
    residual: float


@dataclass(frozen=True)
class _Problem:
    """Equations of rest in the unknowns [position, rotation vector from `rotation`, end forces]."""

    robot: Robot
    unstrained_length: Array
    rotation: Array

    @property
    def force_scale(self) -> float:
        """Forces are counted in shares of the weight [N]."""
        return self.robot.weight / self.robot.n

    def residual(self, unknown: Array) -> Array:
        """Closure of each cable [m], then force and moment balance over the weight [-, m].

        Args:
            unknown: Shape (..., 6 + 3 n); the residual has the same.
        """
        robot = self.robot
        position, turn = unknown[..., :3], _rotation(unknown[..., 3:6], self.rotation)
        force = unknown[..., 6:].reshape(*unknown.shape[:-1], robot.n, 3) * self.force_scale
        arm = robot.anchor_points @ turn.swapaxes(-1, -2)
        anchor = position[..., None, :] + arm
        closure = cable_closure(robot, self.unstrained_length, anchor, force)
        weight = np.array([0.0, 0.0, -robot.weight], dtype=LONG)
        balance = force.sum(axis=-2) + weight
        moment = np.cross(arm, force).sum(axis=-2)
        moment = moment + np.cross(turn @ robot.center_of_mass, weight)
        closure = closure.reshape(*unknown.shape[:-1], 3 * robot.n)
        return np.concatenate([closure, balance / robot.weight, moment / robot.weight], axis=-1)

    def jacobian(self, unknown: Array) -> Array:
        """Central differences in extended precision, all of them in one batch."""
        step = LONG(1e-7) * np.maximum(LONG(1), np.abs(unknown))
        moves = np.diag(step)
        ahead, behind = self.residual(np.stack([unknown + moves, unknown - moves]))
        return np.array((ahead - behind) / (2 * step[:, None]), dtype=np.float64).T


def cable_closure(robot: Robot, unstrained_length: Array, anchor: Array, force: Array) -> Array:
    """Gap between the upper end of each cable and its tangent point [m], shape (..., n, 3).

    Integrates the cable from the anchor: the tension vector after material s is f + w s z, so the
    tangent vector is its unit vector times one plus strain. The tangent point follows from the
    direction in which the cable leaves the pulley, which swivels without friction.

    Args:
        robot: Robot description, n cables.
        unstrained_length: Datum to anchor, material [m], shape (n,).
        anchor: Anchor points in W [m], shape (..., n, 3).
        force: Of each cable on the platform [N], shape (..., n, 3).
    """
    w, ea = robot.weight_per_length.astype(LONG), robot.axial_stiffness.astype(LONG)
    upright = np.array([0, 0, 1], dtype=LONG)
    free = unstrained_length.astype(LONG)
    for _ in range(60):  # free length and upper tension depend on each other: a contraction
        top = force + (w * free)[..., None] * upright
        tension = _norm(top)
        strain = tension / ea
        tangent_point, wrap = _tangent(robot, -top / tension[..., None])
        stretched = robot.run_length * strain / (1 + strain)
        new = unstrained_length + stretched - robot.pulley_radius * wrap / (1 + strain)
        done = np.abs(new - free).max() < 1e-18
        free = new
        if done:
            break
    top = force + (w * free)[..., None] * upright
    lower, upper = _norm(force), _norm(top)
    horizontal2 = force[..., 0] ** 2 + force[..., 1] ** 2
    sines = np.log(
        _plus(top[..., 2], upper, horizontal2) / _plus(force[..., 2], lower, horizontal2)
    )
    reach = force * (free / ea)[..., None]
    reach[..., :2] += force[..., :2] * (sines / w)[..., None]
    reach[..., 2] += (upper - lower) / w + w * free**2 / (2 * ea)
    return np.asarray(anchor + reach - tangent_point)


def cable_wrench(
    robot: Robot, unstrained_length: Array, position: Array, rotation: Array, exit_tension: Array
) -> Array:
    """Wrench on the platform at its origin, weight included [N, N m], shape (6,).

    The cables of given lengths are closed by Newton on `cable_closure` from a first guess.

    Args:
        robot: Robot description, n cables.
        unstrained_length: [m], shape (n,).
        position: Platform origin in W [m], shape (3,).
        rotation: Rotation from P to W, shape (3, 3).
        exit_tension: First guess of the tension vectors at the exits [N], shape (n, 3).
    """
    arm = robot.anchor_points @ rotation.T
    force = np.array(exit_tension, dtype=LONG)
    force[:, 2] -= robot.weight_per_length * unstrained_length
    steps = 1e-3 * np.eye(3)[:, None, :]
    for _ in range(12):
        gap = cable_closure(robot, unstrained_length, position + arm, force)
        both = np.stack([force + steps, force - steps])
        ahead, behind = cable_closure(robot, unstrained_length, position + arm, both)
        slope = np.moveaxis((ahead - behind) / 2e-3, 0, -1).astype(np.float64)
        change = np.linalg.solve(slope, np.asarray(gap, dtype=np.float64)[..., None])[..., 0]
        force = force - change
    total = np.asarray(force, dtype=np.float64)
    weight = np.array([0.0, 0.0, -robot.weight])
    moment = np.cross(arm, total).sum(axis=0) + np.cross(rotation @ robot.center_of_mass, weight)
    return np.concatenate([total.sum(axis=0) + weight, moment])


def _norm(vector: Array) -> Array:
    """Length of vectors of three in extended precision, where numpy's own sums are slow."""
    return np.asarray(np.sqrt(vector[..., 0] ** 2 + vector[..., 1] ** 2 + vector[..., 2] ** 2))


def _plus(vertical: Array, tension: Array, horizontal2: Array) -> Array:
    """V + T without cancellation where V < 0."""
    away = np.where(vertical < 0, tension - vertical, LONG(1))
    return np.where(vertical < 0, horizontal2 / away, vertical + tension)


def _tangent(robot: Robot, direction: Array) -> tuple[Array, Array]:
    """Tangent points [m] and wraps [rad] of cables that leave their pulleys in given directions."""
    axis = robot.swivel_axis
    product = direction * axis
    along = product[..., 0] + product[..., 1] + product[..., 2]
    sideways = direction - along[..., None] * axis
    sine = _norm(sideways)
    e = sideways / np.maximum(sine, LONG(1e-300))[..., None]
    wrap = np.where(robot.pulley_radius > 0, np.arctan2(sine, along), 0)
    offset = (1 - np.cos(wrap))[..., None] * e + np.sin(wrap)[..., None] * axis
    return robot.exit_points + robot.pulley_radius[:, None] * offset, wrap


def _rotation(vector: Array, base: Array) -> Array:
    """Rotations by vectors in W, (..., 3), after `base`, in extended precision (Rodrigues)."""
    angle2 = (vector**2).sum(axis=-1)[..., None, None]
    angle = np.sqrt(angle2)
    small = angle < 1e-3
    safe = np.where(small, LONG(1), angle)
    a = 1 - angle2 / 6 * (1 - angle2 / 20 * (1 - angle2 / 42))
    a = np.where(small, a, np.sin(safe) / safe)
    b = LONG(0.5) - angle2 / 24 * (1 - angle2 / 30 * (1 - angle2 / 56))
    b = np.where(small, b, (1 - np.cos(safe)) / safe**2)
    k = np.zeros((*vector.shape[:-1], 3, 3), dtype=LONG)
    for i, j in ((0, 1), (1, 2), (2, 0)):
        k[..., j, i] = vector[..., 3 - i - j]
        k[..., i, j] = -k[..., j, i]
    turn = np.eye(3, dtype=LONG) + a * k + b * (k @ k)
    return np.asarray(turn @ base)


def equilibrium(
    robot: Robot, unstrained_length: Array, position: Array, rotation: Array
) -> ReferenceEquilibrium:
    """Rest of a platform on elastic catenaries over pulleys, near a first guess of the pose.

    All 6 + 3 n equations at once by scipy, then Newton with extended-precision residuals. Check
    the returned residual: some guesses lead nowhere.

    Args:
        robot: Robot description, n cables.
        unstrained_length: [m], shape (n,).
        position: First guess of the platform origin in W [m], shape (3,).
        rotation: First guess of the rotation from P to W, shape (3, 3).
    """
    lengths = np.asarray(unstrained_length, dtype=np.float64)
    problem = _Problem(robot, lengths, np.asarray(rotation, dtype=np.float64))
    force = _first_forces(robot, lengths, np.asarray(position), problem.rotation)
    unknown = np.concatenate([position, np.zeros(3), (force / problem.force_scale).ravel()])
    with np.errstate(all="ignore"):
        rough = least_squares(
            lambda u: problem.residual(u.astype(LONG)).astype(np.float64),
            unknown,
            jac=lambda u: problem.jacobian(u.astype(LONG)),
            method="lm",
            xtol=1e-15,
            ftol=1e-15,
            gtol=1e-15,
            max_nfev=2000,
        )
        fine = rough.x.astype(LONG)
        for _ in range(4):
            miss = problem.residual(fine)
            fine = fine - np.linalg.solve(problem.jacobian(fine), miss.astype(np.float64))
        residual = float(np.abs(problem.residual(fine)).max())
    tension = np.linalg.norm(fine[6:].reshape(-1, 3).astype(np.float64), axis=1)
    turn = _rotation(fine[3:6], problem.rotation).astype(np.float64)
    scale = problem.force_scale
    return ReferenceEquilibrium(fine[:3].astype(np.float64), turn, tension * scale, residual)


def _first_forces(robot: Robot, length: Array, position: Array, rotation: Array) -> Array:
    """End forces to start from: slack cables hang, the others share the rest of the weight."""
    anchor = position + robot.anchor_points @ rotation.T
    chord = robot.exit_points - anchor
    distance = np.linalg.norm(chord, axis=1)
    force = np.zeros((robot.n, 3))
    slack = (length > distance * 1.002) & (robot.pulley_radius == 0)
    for i in np.flatnonzero(slack):
        flat = np.hypot(chord[i, 0], chord[i, 1])
        w, ea = robot.weight_per_length[i], robot.axial_stiffness[i]
        h, v = catenary(max(flat, 1e-6), chord[i, 2], length[i], w, ea)
        force[i] = [*(h * chord[i, :2] / max(flat, 1e-6)), v]
    if not slack.all():
        unit = (chord / distance[:, None])[~slack]
        load = np.array([0.0, 0.0, robot.weight]) - force.sum(axis=0)
        share, _ = nnls(unit.T, load)
        even = robot.weight / robot.n / 4
        force[~slack] = unit * np.maximum(share, even)[:, None]
    return force


# --- Tensions within limits --------------------------------------------------------------------


def tension_distribution_osqp(
    structure: Array, wrench: Array, lower: Array, upper: Array
) -> Array | None:
    """Tensions of least norm with A f + w = 0 and lower <= f <= upper, by osqp; None: infeasible.

    Args:
        structure: Structure matrix A, shape (6, n).
        wrench: External wrench w on the platform [N, N m], shape (6,).
        lower: Lowest tensions [N], shape (n,).
        upper: Highest tensions [N], shape (n,).
    """
    import osqp
    from scipy import sparse

    n = structure.shape[1]
    solver = osqp.OSQP()
    solver.setup(
        P=sparse.eye(n, format="csc"),
        q=np.zeros(n),
        A=sparse.csc_matrix(np.vstack([structure, np.eye(n)])),
        l=np.concatenate([-wrench, lower]),
        u=np.concatenate([-wrench, upper]),
        eps_abs=1e-10,
        eps_rel=1e-10,
        eps_prim_inf=1e-10,
        max_iter=200_000,
        polishing=True,
        polish_refine_iter=20,
        delta=1e-9,
        scaling=10,
        verbose=False,
    )
    result = solver.solve(raise_error=False)
    return np.asarray(result.x) if result.info.status == "solved" else None


def tension_distribution_nnls(
    structure: Array, wrench: Array, lower: Array, upper: Array
) -> Array | None:
    """The same tensions by least-distance programming on the null space; None: infeasible.

    Lawson and Hanson, *Solving Least Squares Problems*, chapter 23: minimise |z| subject to
    G z >= h is one non-negative least-squares problem, solved exactly by `scipy.optimize.nnls`.
    """
    particular = -np.linalg.pinv(structure) @ wrench
    if np.abs(structure @ particular + wrench).max() > 1e-9 * (1.0 + np.abs(wrench).max()):
        return None
    _, values, rows = np.linalg.svd(structure)
    null = rows[int((values > 1e-10 * values[0]).sum()) :].T
    if null.shape[1] == 0:
        inside = (particular >= lower - 1e-9).all() and (particular <= upper + 1e-9).all()
        return particular if inside else None
    scale = np.abs(upper).max()
    g = np.vstack([null, -null])
    h = np.concatenate([lower - particular, particular - upper]) / scale
    system = np.vstack([g.T, h])
    goal = np.append(np.zeros(null.shape[1]), 1.0)
    multiplier, distance = nnls(system, goal)
    if distance < 1e-9:
        return None
    r = system @ multiplier - goal
    return np.asarray(particular + null @ (-r[:-1] / r[-1]) * scale)


# --- Rigid body --------------------------------------------------------------------------------


def mass_matrix(robot: Robot, rotation: Array) -> Array:
    """Mass matrix of the platform through pin, shape (6, 6).

    For the twist [v; omega] in W at the platform origin: linear first, momentum = M twist.
    """
    import pinocchio as pin

    body = pin.Inertia(robot.mass, np.array(robot.center_of_mass), np.array(robot.inertia))
    return np.asarray(body.se3Action(pin.SE3(np.array(rotation), np.zeros(3))).matrix())


def bias_wrench(robot: Robot, rotation: Array, twist: Array) -> Array:
    """Velocity terms c of M [dv/dt; domega/dt] + c = wrench in W at the platform origin, (6,).

    The accelerations are those of the platform origin (classical, not spatial).
    """
    import pinocchio as pin

    body = pin.Inertia(robot.mass, np.array(robot.center_of_mass), np.array(robot.inertia))
    body = body.se3Action(pin.SE3(np.array(rotation), np.zeros(3)))
    velocity = pin.Motion(np.array(twist))
    spatial = np.concatenate([np.cross(twist[3:], twist[:3]), np.zeros(3)])  # a = dv/dt - w x v
    return np.asarray(body.vxiv(velocity).vector - body.matrix() @ spatial)


def random_rotation(rng: np.random.Generator, angle: float) -> Array:
    """A rotation by up to `angle` [rad] about a random axis."""
    axis = rng.normal(size=3)
    vector = axis / np.linalg.norm(axis) * rng.uniform(0.0, angle)
    return np.asarray(Rotation.from_rotvec(vector).as_matrix())
