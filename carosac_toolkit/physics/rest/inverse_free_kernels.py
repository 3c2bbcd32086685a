"""Inverse kinematics with the rotation free (fewer than six cables).

A Newton method on the conditions of optimality (Lagrange multipliers y of the six balances) finds
the least squared tensions within the limits, starting from a stable rest on straight cables.
"""

import warp as wp

from carosac_toolkit.physics.cable.catenary_kernels import (
    DIVISION_FLOOR,
    HALF,
    ONE,
    TWO,
    ZERO,
    vec6d,
)
from carosac_toolkit.physics.cable.straight_line_kernels import Straight, straight_to
from carosac_toolkit.physics.cable.tension_kernels import (
    LEAST_TENSION_FACTOR,
    LEAST_TENSION_FACTOR_WIDE,
)
from carosac_toolkit.physics.device_kernels import Cable, StaticBody
from carosac_toolkit.physics.rest.bounded_kernels import bounded_tensions
from carosac_toolkit.physics.rest.inverse_kernels import (
    STATUS_CONVERGED,
    STATUS_FAILED,
    STATUS_INFEASIBLE,
    TENSION_CHANGE_PER_WEIGHT,
    TENSION_RESIDUAL_PER_WEIGHT,
    TENSION_STEPS_MAX,
    first_tensions,
    pull_cables,
    set_limits,
)
from carosac_toolkit.physics.rest.platform_kernels import (
    Poses,
    add_lever,
    descent_step,
    gravity_balance,
    mat66d,
    orthonormal,
    rotation_of,
    scaled_norm,
    turned,
)
from carosac_toolkit.physics.rest.start_kernels import START_TILT_RAD, fit_straight

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

mat99d = wp.types.matrix((9, 9), wp.float64)
vec9d = wp.types.vector(9, wp.float64)

RIDGE_MIN = wp.constant(wp.float64(1.0e-3))  # curvature of squared tensions by rotation [weight^2]
RIDGE_MAX = wp.constant(wp.float64(1.0e6))
TURNS_MAX = wp.constant(60)
POINT_SHARE = wp.constant(wp.float64(2.0e-3))  # of a cable: 20 times what straight cables fit to
FREE_ATTEMPTS = wp.constant(6)  # rotations to start from, the later ones only where the first fails
POINT_ATTEMPTS = wp.constant(8)  # the same of a point, which may turn to any heading
POINT_TURN_RAD = wp.constant(wp.float64(0.8975979010256552))  # a seventh turn between headings


@wp.func
def solve9(matrix: mat99d, right: vec9d) -> vec9d:
    """Solve by Gaussian elimination with partial pivoting."""
    a = matrix
    x = right
    for j in range(9):
        p = int(j)
        for i in range(j + 1, 9):
            if wp.abs(a[i, j]) > wp.abs(a[p, j]):
                p = i
        for k in range(9):
            above = a[j, k]
            a[j, k] = a[p, k]
            a[p, k] = above
        above = x[j]
        x[j] = x[p]
        x[p] = above
        pivot = a[j, j] + DIVISION_FLOOR
        for i in range(j + 1, 9):
            f = a[i, j] / pivot
            for k in range(j, 9):
                a[i, k] = a[i, k] - f * a[j, k]
            x[i] = x[i] - f * x[j]
    for back in range(9):
        j = 8 - back
        s = x[j]
        for k in range(j + 1, 9):
            s -= a[j, k] * x[k]
        x[j] = s / (a[j, j] + DIVISION_FLOOR)
    return x


@wp.func
def dual_gradient(
    straight: Straight, arm: wp.vec3d, dual_force: wp.vec3d, dual_moment: wp.vec3d
) -> wp.vec3d:
    """Return the rotation gradient of u . (y_f + y_m x arm) of a straight cable."""
    v = dual_force + wp.cross(dual_moment, arm)
    h = wp.cross(straight.unit, dual_moment) - straight.bend * v
    return wp.cross(arm, h)


@wp.func
def dual_gradient_sum(cables: wp.array2d(dtype=Cable), row: int, b: int, body: StaticBody,
                      p: wp.vec3d, r: wp.mat33d, dual_force: wp.vec3d, dual_moment: wp.vec3d,
                      poses: Poses) -> wp.vec3d:  # fmt: skip
    """Return the gradient of y . wrench under a rotation of the platform."""
    weight = wp.vec3d(ZERO, ZERO, -body.weight)
    out = wp.cross(r * body.center_of_mass, wp.cross(weight, dual_moment))
    for i in range(poses.tension.shape[1]):
        arm = r * cables[row, i].anchor_point
        s = straight_to(cables[row, i], p + arm)
        out += poses.tension[b, i] * dual_gradient(s, arm, dual_force, dual_moment)
    return out


@wp.func
def dual_curvature(cables: wp.array2d(dtype=Cable), row: int, b: int, body: StaticBody,
                   p: wp.vec3d, r: wp.mat33d, dual_force: wp.vec3d, dual_moment: wp.vec3d,
                   poses: Poses) -> wp.mat33d:  # fmt: skip
    """Return minus the second rotation derivative of y . wrench, by central differences."""
    h = wp.float64(1.0e-4)
    out = wp.mat33d()
    for axis in range(3):
        tilt = wp.vec3d()
        tilt[axis] = h
        plus = dual_gradient_sum(
            cables, row, b, body, p, rotation_of(tilt) * r, dual_force, dual_moment, poses
        )
        minus = dual_gradient_sum(
            cables, row, b, body, p, rotation_of(-tilt) * r, dual_force, dual_moment, poses
        )
        change = (minus - plus) / (TWO * h)
        for k in range(3):
            out[k, axis] = change[k]
    return HALF * (out + wp.transpose(out))


@wp.func
def optimality_row(column: vec6d, twist: wp.vec3d, weight: wp.float64) -> vec9d:
    """Return the derivatives of a cable's tension, in weights, by multipliers and rotation."""
    return vec9d(
        column[0], column[1], column[2], column[3], column[4], column[5],
        twist[0] / weight, twist[1] / weight, twist[2] / weight,
    )  # fmt: skip


@wp.func
def optimality_step(b: int, body: StaticBody, balance_wrench: vec6d, stiffness: mat66d,
                    curvature: wp.mat33d, ridge: wp.float64, poses: Poses) -> vec9d:  # fmt: skip
    """Return the Newton step (multipliers, rotation) for the cables now held at limits.

    All in weights and typical lever arms, so that the pivots do not depend on the robot's size.
    """
    weight = body.weight
    matrix = mat99d()
    right = vec9d()
    for i in range(6):
        lever = weight * wp.where(i < 3, ONE, body.arm)
        right[i] = -balance_wrench[i] / lever
        matrix[i, i] = wp.float64(1.0e-13)
        for j in range(3):
            matrix[i, 6 + j] = -stiffness[i, 3 + j] / lever
            matrix[6 + j, i] = -stiffness[i, 3 + j] / lever
    for i in range(3):
        for j in range(3):
            matrix[6 + i, 6 + j] = -curvature[i, j] / (weight * weight)
        matrix[6 + i, 6 + i] = matrix[6 + i, 6 + i] - ridge
    for i in range(poses.tension.shape[1]):
        line = optimality_row(poses.column[b, i], poses.twist[b, i], weight)
        if poses.bound[b, i] == 0:
            matrix = matrix + wp.outer(line, line)
            right = right + poses.tension[b, i] / weight * line
        else:
            held = wp.where(poses.bound[b, i] == 1, poses.lower[b, i], poses.upper[b, i])
            right = right - (held - poses.tension[b, i]) / weight * line
    return solve9(matrix, right)


@wp.struct
class Choice:
    """Tensions that a Newton step leads to."""

    changed: int  # the set of cables held at a limit changed
    inside: int  # no cable is, was or wants to be beyond a limit
    slope: wp.float64  # of the squared tensions along the step [N^2]
    jump: wp.float64  # largest change of a tension [N]


@wp.func
def beyond(lower: wp.float64, upper: wp.float64, tension: wp.float64) -> int:
    """Return 1 below the lower limit, 2 above the upper one, 0 between."""
    if tension < lower:
        return 1
    if tension > upper:
        return 2
    return 0


@wp.func
def choose(b: int, weight: wp.float64, step: vec9d, poses: Poses) -> Choice:
    """Choose tensions of a step, and which cables to hold at a limit.

    n tensions and 3 rotations fulfil 6 balances, so no more than n - 3 cables can be held. Those
    held already stay while their multiplier keeps them there; then the worst offender joins. Other
    offenders go where the balance takes them: the end is judged by the limits again.
    """
    out = Choice()
    out.inside = 1
    held = int(0)
    worst = int(-1)
    most = wp.float64(0.0)
    for i in range(poses.tension.shape[1]):
        low = poses.lower[b, i]
        high = poses.upper[b, i]
        line = optimality_row(poses.column[b, i], poses.twist[b, i], weight)
        t = weight * wp.dot(line, step)
        side = beyond(low, high, t)
        if side != 0 or poses.bound[b, i] != 0 or beyond(low, high, poses.tension[b, i]) != 0:
            out.inside = 0
        if poses.bound[b, i] != 0 and side != poses.bound[b, i]:
            poses.bound[b, i] = 0
            out.changed = 1
        if poses.bound[b, i] != 0:
            held += 1
            t = wp.clamp(t, low, high)
        elif side != 0:
            offence = wp.max(low - t, t - high)
            if offence > most:
                most = offence
                worst = i
        t = wp.max(t, wp.max(wp.float64(0.2) * poses.tension[b, i], HALF * low))
        poses.wanted[b, i] = t
        out.slope += poses.tension[b, i] * (t - poses.tension[b, i])
        out.jump = wp.max(out.jump, wp.abs(t - poses.tension[b, i]))
    if worst >= 0 and held < poses.tension.shape[1] - 3:
        line = optimality_row(poses.column[b, worst], poses.twist[b, worst], weight)
        t = weight * wp.dot(line, step)
        poses.bound[b, worst] = beyond(poses.lower[b, worst], poses.upper[b, worst], t)
        out.changed = 1
    return out


@wp.struct
class TensionStep:
    """A Newton step and the tensions it leads to."""

    step: vec9d
    choice: Choice


@wp.func
def search(b: int, body: StaticBody, wrench: vec6d, stiffness: mat66d, curvature: wp.mat33d,
           balanced: bool, poses: Poses) -> TensionStep:  # fmt: skip
    """Find the Newton step for the right set of cables at their limits.

    At balance a step must not raise the squared tensions: there a ridge on the rotation grows
    until it does not, so that the end is a minimum and no other stationary point.
    """
    out = TensionStep()
    ridge = wp.float64(0.0)
    tries = int(0)
    searching = bool(True)
    while searching:
        out.step = optimality_step(b, body, wrench, stiffness, curvature, ridge, poses)
        out.choice = choose(b, body.weight, out.step, poses)
        tries += 1
        searching = out.choice.changed == 1 and tries < 12
        rising = out.choice.slope > wp.float64(1.0e-6) * body.weight * body.weight
        steep = ridge >= RIDGE_MAX
        free = out.choice.inside == 1
        if not searching and rising and balanced and free and not steep:
            ridge = wp.max(ridge * wp.float64(4.0), RIDGE_MIN)
            tries = 0
            searching = True
    return out


@wp.func
def verdict(b: int, tension: wp.array2d(dtype=wp.float64), poses: Poses) -> int:
    """Judge tensions by their limits."""
    for i in range(tension.shape[1]):
        slip = wp.float64(1.0e-9) * poses.upper[b, i]
        if tension[b, i] < poses.lower[b, i] - slip or tension[b, i] > poses.upper[b, i] + slip:
            return STATUS_INFEASIBLE
    return STATUS_CONVERGED


@wp.func
def forces(b: int, body: StaticBody, poses: Poses) -> wp.float64:
    """Return the sum of the forces on the platform [N]: rounding errors grow with it."""
    total = body.weight
    for i in range(poses.tension.shape[1]):
        total += poses.tension[b, i]
    return total


@wp.struct
class TensionSearch:
    """End of one search."""

    rotation: wp.mat33d
    status: int
    steps: int


@wp.func
def optimise(cables: wp.array2d(dtype=Cable), row: int, b: int, body: StaticBody, p: wp.vec3d,
             r0: wp.mat33d, poses: Poses) -> TensionSearch:  # fmt: skip
    """Solve the conditions of optimality by Newton from one rotation and its first tensions."""
    n = poses.tension.shape[1]
    out = TensionSearch()
    out.rotation = r0
    out.status = -1
    dual_force = wp.vec3d()
    dual_moment = wp.vec3d()
    while out.status < 0:
        r = out.rotation
        here = pull_cables(cables, row, b, body, p, r, poses)
        out.steps += 1
        norm = scaled_norm(here.balance.wrench, body.arm)
        curvature = dual_curvature(cables, row, b, body, p, r, dual_force, dual_moment, poses)
        for i in range(n):
            arm = r * cables[row, i].anchor_point
            s = straight_to(cables[row, i], p + arm)
            poses.twist[b, i] = dual_gradient(s, arm, dual_force, dual_moment)
        newton = search(
            b, body, here.balance.wrench, here.balance.stiffness, curvature,
            norm < wp.float64(1.0e-3) * body.weight, poses,
        )  # fmt: skip
        step = newton.step
        turn = wp.vec3d(step[6], step[7], step[8])
        angle = wp.length(turn)
        dual_force = body.weight * wp.vec3d(step[0], step[1], step[2])
        dual_moment = body.weight / body.arm * wp.vec3d(step[3], step[4], step[5])
        steady = (
            newton.choice.jump <= TENSION_CHANGE_PER_WEIGHT * body.weight
            and angle <= wp.float64(10.0) * TENSION_CHANGE_PER_WEIGHT
        )
        if (
            norm <= TENSION_RESIDUAL_PER_WEIGHT * forces(b, body, poses)
            and steady
            and newton.choice.changed == 0
        ):
            out.status = verdict(b, poses.tension, poses)
        elif out.steps >= TENSION_STEPS_MAX:
            refused = verdict(b, poses.wanted, poses) == STATUS_INFEASIBLE
            out.status = wp.where(refused, STATUS_INFEASIBLE, STATUS_FAILED)
        else:
            scale = wp.min(ONE, wp.float64(0.2) / (angle + DIVISION_FLOOR))
            for i in range(n):
                poses.tension[b, i] = poses.tension[b, i] + scale * (
                    poses.wanted[b, i] - poses.tension[b, i]
                )
            out.rotation = orthonormal(rotation_of(scale * turn) * r)
    return out


@wp.func
def is_point(cables: wp.array2d(dtype=Cable), row: int, body: StaticBody, n: int) -> int:
    """Return 1 if the platform is so small that straight cables turn it by chance."""
    largest = wp.float64(0.0)
    for i in range(n):
        largest = wp.max(largest, wp.length(cables[row, i].anchor_point))
    return wp.where(largest < POINT_SHARE * body.size, 1, 0)


@wp.func
def balance_forces(cables: wp.array2d(dtype=Cable), row: int, b: int, body: StaticBody,
                   p: wp.vec3d, r: wp.mat33d, poses: Poses):  # fmt: skip
    """Set the least squared tensions within their limits that carry the weight, moments aside."""
    for i in range(poses.tension.shape[1]):
        s = straight_to(cables[row, i], p + r * cables[row, i].anchor_point)
        poses.column[b, i] = vec6d(s.unit[0], s.unit[1], s.unit[2], ZERO, ZERO, ZERO)
        poses.middle[b, i] = ZERO
        poses.softness[b, i] = ONE
    target = vec6d(ZERO, ZERO, body.weight, ZERO, ZERO, ZERO)
    bounded_tensions(
        poses.column, poses.lower, poses.upper, poses.middle, poses.softness, b, target,
        poses.tension,
    )  # fmt: skip


@wp.func
def turn_freely(cables: wp.array2d(dtype=Cable), row: int, b: int, body: StaticBody,
                p: wp.vec3d, first: wp.mat33d, poses: Poses) -> wp.mat33d:  # fmt: skip
    """Return the rotation nearby in which constant tensions and the weight turn no further."""
    r = first
    none = wp.mat33d()
    for _step in range(TURNS_MAX):
        total = gravity_balance(body, r)
        for i in range(poses.tension.shape[1]):
            arm = r * cables[row, i].anchor_point
            s = straight_to(cables[row, i], p + arm)
            force = poses.tension[b, i] * s.unit
            total = add_lever(total.stiffness, total.wrench, arm, force, none)
        for i in range(3):  # the position is held
            total.wrench[i] = ZERO
            total.stiffness[i, i] = body.weight / body.size
        moment = wp.vec3d(total.wrench[3], total.wrench[4], total.wrench[5])
        if wp.length(moment) < wp.float64(1.0e-9) * body.weight * body.arm:
            break
        r = turned(r, descent_step(total, body, ONE, wp.float64(0.5)).step)
    return r


@wp.func
def start_rotation(attempt: int, point: int, rotation: wp.mat33d) -> wp.mat33d:
    """Return the initial rotation, twice, then tilted ones, or of a point other headings."""
    tilt = wp.vec3d()
    if attempt > 1 and point == 1:
        tilt[2] = POINT_TURN_RAD * wp.float64(attempt - 1)
    elif attempt > 1:
        tilt[attempt % 2] = wp.where(attempt > 3, -START_TILT_RAD, START_TILT_RAD)
    return rotation_of(tilt) * rotation


@wp.kernel
def inverse_free(cables: wp.array2d(dtype=Cable), bodies: wp.array(dtype=StaticBody), poses: Poses):
    """Find least squared tensions in equilibrium, rotation free, from a stable rest nearby.

    Where that fails, once more with a wider margin over the least tension of a hanging cable, then
    from other rotations; what is reported then is the last attempt. How a search ends that leads
    nowhere depends on rounding, so all of them get one status.
    """
    b = wp.tid()
    row = wp.min(b, cables.shape[0] - 1)
    body = bodies[wp.min(b, bodies.shape[0] - 1)]
    p = poses.position[b]
    first_rotation = poses.rotation[b]
    out = TensionSearch()
    steps = int(0)
    attempt = int(0)
    point = is_point(cables, row, body, poses.tension.shape[1])
    attempts = wp.where(point == 1, POINT_ATTEMPTS, FREE_ATTEMPTS)
    while attempt < attempts and out.status != STATUS_CONVERGED:
        r = start_rotation(attempt, point, first_rotation)
        if point == 0:
            r = fit_straight(cables, row, b, body, p, r, poses)
        margin = wp.where(attempt == 1, LEAST_TENSION_FACTOR_WIDE, LEAST_TENSION_FACTOR)
        set_limits(cables, row, b, body, p, r, margin, poses)
        if point == 1:
            balance_forces(cables, row, b, body, p, r, poses)
            r = turn_freely(cables, row, b, body, p, r, poses)
        first_tensions(cables, row, b, p, r, poses)
        for i in range(poses.tension.shape[1]):
            poses.bound[b, i] = 0
        out = optimise(cables, row, b, body, p, r, poses)
        steps += out.steps
        attempt += 1
    poses.rotation[b] = out.rotation
    poses.status[b] = wp.where(out.status == STATUS_CONVERGED, STATUS_CONVERGED, STATUS_INFEASIBLE)
    poses.steps[b] = steps
