"""Inverse kinematics: lengths and tensions that hold the platform at a position.

Each cable's tension at the platform is an unknown; its length and direction follow from it (sag,
pulley and run included). With six cables or more the rotation is held and the tensions solve a
bounded least-squares problem, linearised anew until it stays. With fewer the rotation is free: a
Newton method on the conditions of optimality (Lagrange multipliers y of the six balances) finds
the least squared tensions within the limits, starting from a stable rest on straight cables.
"""

import warp as wp

from carosac_toolkit.physics.bounded_kernels import bounded_tensions
from carosac_toolkit.physics.cable_kernels import HALF, ONE, TINY, TWO, ZERO, Cable, vec6d
from carosac_toolkit.physics.cable_tension_kernels import Pulling, guess_pull, pull
from carosac_toolkit.physics.forward_kernels import Loaded, load_cables
from carosac_toolkit.physics.platform_kernels import (
    Body,
    add_lever,
    anchor_of,
    factorise,
    gravity_balance,
    mat66d,
    orthonormal,
    rotation_of,
    scaled_norm,
)
from carosac_toolkit.physics.start_kernels import Straight, cold_start, straight_to

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

mat99d = wp.types.matrix((9, 9), wp.float64)
vec9d = wp.types.vector(9, wp.float64)

LIMIT = wp.constant(80)
ROUNDS = wp.constant(4)  # of fitting straight cables to the position
RESIDUAL = wp.constant(wp.float64(1.0e-11))  # of the weight
STEADY = wp.constant(wp.float64(1.0e-9))  # change of tension, of the weight; of rotation [rad]

FAILED = wp.constant(0)
CONVERGED = wp.constant(1)
INFEASIBLE = wp.constant(2)


@wp.func
def solve9(matrix: mat99d, right: vec9d) -> vec9d:
    """Gaussian elimination with partial pivoting."""
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
        pivot = a[j, j] + TINY
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
        x[j] = s / (a[j, j] + TINY)
    return x


@wp.func
def pull_cables(cables: wp.array2d(dtype=Cable), row: int, b: int, body: Body, p: wp.vec3d,
                r: wp.mat33d, tension: wp.array2d(dtype=wp.float64),
                lengths: wp.array2d(dtype=wp.float64), q: wp.array2d(dtype=wp.vec3d),
                column: wp.array2d(dtype=vec6d)) -> Loaded:  # fmt: skip
    """Cables of given tension at one pose: wrench, stiffness at constant tension, columns.

    A column is d wrench / d tension, its moment divided by the typical lever arm.
    """
    out = Loaded()
    out.balance = gravity_balance(body, r)
    for i in range(tension.shape[1]):
        anchor = anchor_of(cables[row, i], p, r)
        g = Pulling()
        g.q = q[b, i]
        g.unstrained_length = lengths[b, i]
        g = pull(g, anchor, tension[b, i], cables[row, i], wp.float64(1.0e-14), 40)
        q[b, i] = g.q
        lengths[b, i] = g.unstrained_length
        out.gap = wp.max(out.gap, wp.length(g.hanging.closure))
        arm = anchor - p
        out.balance = add_lever(
            out.balance.stiffness, out.balance.wrench, arm, g.hanging.force, g.stiffness
        )
        t = g.force_t
        m = wp.cross(arm, t) / body.arm
        column[b, i] = vec6d(t[0], t[1], t[2], m[0], m[1], m[2])
    return out


@wp.func
def scaled_wrench(wrench: vec6d, arm: wp.float64) -> vec6d:
    """Wrench with its moment divided by the typical lever arm [N]."""
    w = wrench
    for i in range(3):
        w[3 + i] = w[3 + i] / arm
    return w


@wp.func
def first_tensions(cables: wp.array2d(dtype=Cable), row: int, b: int, p: wp.vec3d, r: wp.mat33d,
                   tension: wp.array2d(dtype=wp.float64), lengths: wp.array2d(dtype=wp.float64),
                   q: wp.array2d(dtype=wp.vec3d)):  # fmt: skip
    """Straight cables of tensions clipped to their limits."""
    for i in range(tension.shape[1]):
        cable = cables[row, i]
        tension[b, i] = wp.clamp(tension[b, i], cable.tension_min, cable.tension_max)
        g = guess_pull(anchor_of(cable, p, r), tension[b, i], cable)
        q[b, i] = g.q
        lengths[b, i] = g.unstrained_length


@wp.kernel
def inverse_held(
    cables: wp.array2d(dtype=Cable),
    bodies: wp.array(dtype=Body),
    position: wp.array(dtype=wp.vec3d),
    rotation: wp.array(dtype=wp.mat33d),
    unstrained_length: wp.array2d(dtype=wp.float64),
    q: wp.array2d(dtype=wp.vec3d),
    tension: wp.array2d(dtype=wp.float64),
    wanted: wp.array2d(dtype=wp.float64),
    lower: wp.array2d(dtype=wp.float64),
    upper: wp.array2d(dtype=wp.float64),
    middle: wp.array2d(dtype=wp.float64),
    column: wp.array2d(dtype=vec6d),
    status: wp.array(dtype=int),
    iterations: wp.array(dtype=int),
):
    """Rotation held: bounded least squares, the cables linearised anew until nothing changes."""
    b = wp.tid()
    n = tension.shape[1]
    row = wp.min(b, cables.shape[0] - 1)
    body = bodies[wp.min(b, bodies.shape[0] - 1)]
    p = position[b]
    r = rotation[b]
    for i in range(n):
        lower[b, i] = cables[row, i].tension_min
        upper[b, i] = cables[row, i].tension_max
        middle[b, i] = ZERO
        tension[b, i] = body.weight
    first_tensions(cables, row, b, p, r, tension, unstrained_length, q)
    count = int(0)
    result = int(-1)
    refused = int(0)
    while result < 0:
        here = pull_cables(cables, row, b, body, p, r, tension, unstrained_length, q, column)
        count += 1
        target = -scaled_wrench(here.balance.wrench, body.arm)
        norm = wp.length(target)
        for i in range(n):
            target = target + tension[b, i] * column[b, i]
        feasible = bounded_tensions(column, lower, upper, middle, b, target, wanted)
        refused = wp.where(feasible == 1, 0, refused + 1)
        jump = wp.float64(0.0)
        for i in range(n):
            jump = wp.max(jump, wp.abs(wanted[b, i] - tension[b, i]))
        if feasible == 1 and norm <= RESIDUAL * body.weight and jump <= STEADY * body.weight:
            result = CONVERGED
        elif refused >= 4:
            result = INFEASIBLE
        elif count >= LIMIT:
            result = FAILED
        else:
            for i in range(n):
                tension[b, i] = wanted[b, i]
    status[b] = result
    iterations[b] = count


@wp.func
def dual_gradient(
    straight: Straight, arm: wp.vec3d, dual_force: wp.vec3d, dual_moment: wp.vec3d
) -> wp.vec3d:
    """Gradient of u . (y_f + y_m x arm) under a rotation of the platform, straight cable."""
    v = dual_force + wp.cross(dual_moment, arm)
    h = wp.cross(straight.unit, dual_moment) - straight.bend * v
    return wp.cross(arm, h)


@wp.func
def dual_gradient_sum(cables: wp.array2d(dtype=Cable), row: int, b: int, body: Body, p: wp.vec3d,
                      r: wp.mat33d, tension: wp.array2d(dtype=wp.float64), dual_force: wp.vec3d,
                      dual_moment: wp.vec3d) -> wp.vec3d:  # fmt: skip
    """Gradient of y . wrench under a rotation of the platform."""
    weight = wp.vec3d(ZERO, ZERO, -body.weight)
    out = wp.cross(r * body.center_of_mass, wp.cross(weight, dual_moment))
    for i in range(tension.shape[1]):
        arm = r * cables[row, i].anchor_point
        s = straight_to(cables[row, i], p + arm)
        out += tension[b, i] * dual_gradient(s, arm, dual_force, dual_moment)
    return out


@wp.func
def dual_curvature(cables: wp.array2d(dtype=Cable), row: int, b: int, body: Body, p: wp.vec3d,
                   r: wp.mat33d, tension: wp.array2d(dtype=wp.float64), dual_force: wp.vec3d,
                   dual_moment: wp.vec3d) -> wp.mat33d:  # fmt: skip
    """Minus the second derivative of y . wrench for the rotation, by central differences."""
    h = wp.float64(1.0e-4)
    out = wp.mat33d()
    for axis in range(3):
        tilt = wp.vec3d()
        tilt[axis] = h
        plus = dual_gradient_sum(
            cables, row, b, body, p, rotation_of(tilt) * r, tension, dual_force, dual_moment
        )
        minus = dual_gradient_sum(
            cables, row, b, body, p, rotation_of(-tilt) * r, tension, dual_force, dual_moment
        )
        change = (minus - plus) / (TWO * h)
        for k in range(3):
            out[k, axis] = change[k]
    return HALF * (out + wp.transpose(out))


@wp.func
def optimality_row(column: vec6d, twist: wp.vec3d) -> vec9d:
    """How a cable's tension follows multipliers and rotation."""
    return vec9d(
        column[0], column[1], column[2], column[3], column[4], column[5],
        twist[0], twist[1], twist[2],
    )  # fmt: skip


@wp.func
def optimality_step(cables: wp.array2d(dtype=Cable), row: int, b: int, balance_wrench: vec6d,
                    stiffness: mat66d, arm: wp.float64, curvature: wp.mat33d, ridge: wp.float64,
                    tension: wp.array2d(dtype=wp.float64), column: wp.array2d(dtype=vec6d),
                    twist: wp.array2d(dtype=wp.vec3d), bound: wp.array2d(dtype=int)) -> vec9d:  # fmt: skip
    """Newton step (new multipliers, rotation) for the set of cables now held at their limits."""
    matrix = mat99d()
    right = vec9d()
    for i in range(6):
        lever = wp.where(i < 3, ONE, arm)
        right[i] = -balance_wrench[i] / lever
        matrix[i, i] = wp.float64(1.0e-13)
        for j in range(3):
            matrix[i, 6 + j] = -stiffness[i, 3 + j] / lever
            matrix[6 + j, i] = -stiffness[i, 3 + j] / lever
    for i in range(3):
        for j in range(3):
            matrix[6 + i, 6 + j] = -curvature[i, j]
        matrix[6 + i, 6 + i] = matrix[6 + i, 6 + i] - ridge
    for i in range(tension.shape[1]):
        line = optimality_row(column[b, i], twist[b, i])
        if bound[b, i] == 0:
            matrix = matrix + wp.outer(line, line)
            right = right + tension[b, i] * line
        else:
            held = wp.where(
                bound[b, i] == 1, cables[row, i].tension_min, cables[row, i].tension_max
            )
            right = right - (held - tension[b, i]) * line
    return solve9(matrix, right)


@wp.struct
class Choice:
    """Tensions that a Newton step leads to."""

    changed: int  # the set of cables at their limits changed
    slope: wp.float64  # of the squared tensions along the step [N^2]
    jump: wp.float64  # largest change of a tension [N]


@wp.func
def choose(cables: wp.array2d(dtype=Cable), row: int, b: int, step: vec9d,
           tension: wp.array2d(dtype=wp.float64), column: wp.array2d(dtype=vec6d),
           twist: wp.array2d(dtype=wp.vec3d), bound: wp.array2d(dtype=int),
           wanted: wp.array2d(dtype=wp.float64)) -> Choice:  # fmt: skip
    """Clip the tensions of a step; note which cables sit at a limit."""
    out = Choice()
    for i in range(tension.shape[1]):
        t = wp.dot(optimality_row(column[b, i], twist[b, i]), step)
        side = int(0)
        if t < cables[row, i].tension_min:
            side = 1
        if t > cables[row, i].tension_max:
            side = 2
        if side != bound[b, i]:
            out.changed = 1
        bound[b, i] = side
        t = wp.clamp(t, cables[row, i].tension_min, cables[row, i].tension_max)
        wanted[b, i] = t
        out.slope += tension[b, i] * (t - tension[b, i])
        out.jump = wp.max(out.jump, wp.abs(t - tension[b, i]))
    return out


@wp.kernel
def inverse_free(
    cables: wp.array2d(dtype=Cable),
    bodies: wp.array(dtype=Body),
    position: wp.array(dtype=wp.vec3d),
    rotation: wp.array(dtype=wp.mat33d),
    unstrained_length: wp.array2d(dtype=wp.float64),
    q: wp.array2d(dtype=wp.vec3d),
    tension: wp.array2d(dtype=wp.float64),
    wanted: wp.array2d(dtype=wp.float64),
    column: wp.array2d(dtype=vec6d),
    twist: wp.array2d(dtype=wp.vec3d),
    bound: wp.array2d(dtype=int),
    status: wp.array(dtype=int),
    iterations: wp.array(dtype=int),
):
    """Rotation free: least squared tensions in equilibrium, from a stable rest nearby."""
    b = wp.tid()
    n = tension.shape[1]
    row = wp.min(b, cables.shape[0] - 1)
    body = bodies[wp.min(b, bodies.shape[0] - 1)]
    p = position[b]
    r = rotation[b]
    for _round in range(ROUNDS):
        for i in range(n):
            s = straight_to(cables[row, i], anchor_of(cables[row, i], p, r))
            unstrained_length[b, i] = s.length
        nearby = cold_start(cables, unstrained_length, tension, row, b, body, p, r)
        r = nearby.rotation
    first_tensions(cables, row, b, p, r, tension, unstrained_length, q)
    for i in range(n):
        bound[b, i] = 0
    dual_force = wp.vec3d()
    dual_moment = wp.vec3d()
    count = int(0)
    result = int(-1)
    while result < 0:
        here = pull_cables(cables, row, b, body, p, r, tension, unstrained_length, q, column)
        count += 1
        norm = scaled_norm(here.balance.wrench, body.arm)
        curvature = dual_curvature(cables, row, b, body, p, r, tension, dual_force, dual_moment)
        for i in range(n):
            arm = r * cables[row, i].anchor_point
            s = straight_to(cables[row, i], p + arm)
            twist[b, i] = dual_gradient(s, arm, dual_force, dual_moment)
        ridge = wp.float64(0.0)
        step = vec9d()
        choice = Choice()
        tries = int(0)
        searching = bool(True)
        while searching:
            step = optimality_step(
                cables, row, b, here.balance.wrench, here.balance.stiffness, body.arm, curvature,
                ridge, tension, column, twist, bound,
            )  # fmt: skip
            choice = choose(cables, row, b, step, tension, column, twist, bound, wanted)
            tries += 1
            searching = choice.changed == 1 and tries < 12
            # At balance a step must not raise the tensions: lean towards smaller rotations.
            rising = choice.slope > wp.float64(1.0e-6) * body.weight * body.weight
            balanced = norm < wp.float64(1.0e-3) * body.weight
            if not searching and rising and balanced and ridge < wp.float64(1.0e8) * body.weight:
                ridge = wp.max(ridge * wp.float64(4.0), body.weight * body.arm)
                tries = 0
                searching = True
        turn = wp.vec3d(step[6], step[7], step[8])
        angle = wp.length(turn)
        scale = wp.min(ONE, wp.float64(0.2) / (angle + TINY))
        dual_force = wp.vec3d(step[0], step[1], step[2])
        dual_moment = wp.vec3d(step[3], step[4], step[5]) / body.arm
        steady = choice.jump <= STEADY * body.weight and angle <= STEADY * wp.float64(10.0)
        if norm <= RESIDUAL * body.weight and steady and choice.changed == 0:
            result = CONVERGED
        elif count >= LIMIT:
            result = FAILED
            for i in range(n):
                if bound[b, i] != 0:
                    result = INFEASIBLE
        else:
            for i in range(n):
                tension[b, i] = tension[b, i] + scale * (wanted[b, i] - tension[b, i])
            r = orthonormal(rotation_of(scale * turn) * r)
    rotation[b] = r
    status[b] = result
    iterations[b] = count


@wp.kernel
def evaluate(
    cables: wp.array2d(dtype=Cable),
    bodies: wp.array(dtype=Body),
    unstrained_length: wp.array2d(dtype=wp.float64),
    position: wp.array(dtype=wp.vec3d),
    rotation: wp.array(dtype=wp.mat33d),
    q: wp.array2d(dtype=wp.vec3d),
    inverse: wp.array2d(dtype=wp.mat33d),
    tension: wp.array2d(dtype=wp.float64),
    stiffness: wp.array(dtype=mat66d),
    residual: wp.array(dtype=wp.float64),
    gap: wp.array(dtype=wp.float64),
    stable: wp.array(dtype=int),
):
    """Judge a pose by its lengths alone: wrench left, closure, stiffness, stability."""
    b = wp.tid()
    row = wp.min(b, cables.shape[0] - 1)
    body = bodies[wp.min(b, bodies.shape[0] - 1)]
    here = load_cables(
        cables, unstrained_length, row, b, body, position[b], rotation[b],
        wp.float64(1.0e-13) * body.size, q, inverse, tension,
    )  # fmt: skip
    f = factorise(here.balance.stiffness)
    stiffness[b] = here.balance.stiffness
    residual[b] = scaled_norm(here.balance.wrench, body.arm)
    gap[b] = here.gap
    stable[b] = wp.where(f.pivot_min > ZERO, 1, 0)
