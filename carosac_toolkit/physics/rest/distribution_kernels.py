"""Choice among the tensions that balance a wrench: a convex cost per cable.

    minimise  sum_i phi(x_i),  x_i = (t_i - r_i) / d_i,  subject to  A t = b,  lower <= t <= upper

With phi = x^2 / 2 that is one bounded least-squares problem, else a short sequence of them: Newton
steps with a line search. The cost is strongly convex, so there is one answer.
"""

import warp as wp

from carosac_toolkit.physics.cable.catenary_kernels import HALF, ONE, ZERO, vec6d
from carosac_toolkit.physics.rest.bounded_kernels import bounded_tensions

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

LEAST_SQUARES = wp.constant(0)
MINIMUM = wp.constant(1)
P_NORM = wp.constant(2)
CENTRE = wp.constant(3)

# How far below its lower limit the reference of `minimum` is, over the typical tension: the slope
# of the cost, which is the sum of the tensions, changes by a part in so many per typical tension.
MINIMUM_DEPTH = wp.constant(wp.float64(20.0))
P_NORM_QUADRATIC = wp.constant(wp.float64(1.0e-2))  # share that makes the cost strongly convex
BARRIER_END = wp.constant(wp.float64(0.99))  # of the way to a limit, from where phi is a parabola
NEWTON_STEPS_MAX = wp.constant(60)
NEWTON_CHANGE = wp.constant(wp.float64(1.0e-12))  # of the scale d: smaller steps end the search
SEARCH_CHANGE = wp.constant(wp.float64(1.0e-6))  # of the scale d: smaller steps are taken in full
HALVINGS_MAX = wp.constant(20)


@wp.struct
class Cost:
    """Cost of the tensions, and scratch of its minimisation; arrays (B, n)."""

    choice: int
    reference: wp.array2d(dtype=wp.float64)  # r [N]
    scale: wp.array2d(dtype=wp.float64)  # d [N]
    middle: wp.array2d(dtype=wp.float64)  # reference of one least-squares problem [N]
    softness: wp.array2d(dtype=wp.float64)  # inverse second derivative of the cost [N^2]
    iterate: wp.array2d(dtype=wp.float64)  # tensions before a step [N]


@wp.func
def is_quadratic(choice: int) -> bool:
    """Return True if phi is x^2 / 2."""
    return choice == LEAST_SQUARES or choice == MINIMUM


@wp.func
def phi(choice: int, x: wp.float64) -> wp.vec3d:
    """Return the cost of one cable, its first and its second derivative."""
    x2 = x * x
    if choice == P_NORM:
        q = P_NORM_QUADRATIC
        return wp.vec3d(
            (HALF * q + wp.float64(0.25) * x2) * x2, (q + x2) * x, q + wp.float64(3.0) * x2
        )
    if choice == CENTRE:
        # -log(1 - x^2) / 2, continued as a parabola close to the limits.
        size = wp.min(wp.abs(x), BARRIER_END)
        left = ONE - size * size
        slope = size / left
        bend = (ONE + size * size) / (left * left)
        beyond = wp.abs(x) - size
        value = -HALF * wp.log(left) + (slope + HALF * bend * beyond) * beyond
        return wp.vec3d(value, wp.sign(x) * (slope + bend * beyond), bend)
    return wp.vec3d(HALF * x2, x, ONE)


@wp.func
def set_cost(cost: Cost, lower: wp.array2d(dtype=wp.float64), upper: wp.array2d(dtype=wp.float64),
             b: int, load: wp.float64):  # fmt: skip
    """Set references and scales; those of least squares are given by the caller."""
    n = lower.shape[1]
    typical = load
    for i in range(n):
        typical = typical + lower[b, i]
    typical = typical / wp.float64(n)
    for i in range(n):
        cost.scale[b, i] = wp.where(typical > ZERO, typical, ONE)
        if cost.choice == LEAST_SQUARES:
            cost.scale[b, i] = ONE
        elif cost.choice == MINIMUM:
            cost.reference[b, i] = lower[b, i] - MINIMUM_DEPTH * typical
        elif cost.choice == P_NORM:
            cost.reference[b, i] = ZERO
        else:
            half = HALF * (upper[b, i] - lower[b, i])
            cost.reference[b, i] = lower[b, i] + half
            cost.scale[b, i] = wp.where(half > ZERO, half, ONE)


@wp.func
def cost_along(cost: Cost, b: int, tension: wp.array2d(dtype=wp.float64),
               a: wp.float64) -> wp.float64:  # fmt: skip
    """Return the cost at a share of the way from `iterate` to `tension`."""
    total = wp.float64(0.0)
    for i in range(tension.shape[1]):
        t = cost.iterate[b, i] + a * (tension[b, i] - cost.iterate[b, i])
        total += phi(cost.choice, (t - cost.reference[b, i]) / cost.scale[b, i])[0]
    return total


@wp.func
def step_share(cost: Cost, b: int, tension: wp.array2d(dtype=wp.float64)) -> wp.float64:
    """Return the share of a Newton step that lowers the cost enough (Armijo)."""
    here = cost_along(cost, b, tension, ZERO)
    slope = wp.float64(0.0)
    for i in range(tension.shape[1]):
        t, d = cost.iterate[b, i], cost.scale[b, i]
        slope += phi(cost.choice, (t - cost.reference[b, i]) / d)[1] * (tension[b, i] - t) / d
    a = wp.float64(1.0)
    for _halving in range(HALVINGS_MAX):
        if cost_along(cost, b, tension, a) <= here + wp.float64(1.0e-4) * a * slope:
            break
        a = HALF * a
    return a


@wp.func
def linearise(cost: Cost, b: int, i: int, t: wp.float64):
    """Set reference and softness of the least-squares problem at a tension."""
    d = cost.scale[b, i]
    p = phi(cost.choice, (t - cost.reference[b, i]) / d)
    cost.softness[b, i] = d * d / p[2]
    cost.middle[b, i] = t - d * p[1] / p[2]


@wp.func
def distributed_tensions(column: wp.array2d(dtype=vec6d), lower: wp.array2d(dtype=wp.float64),
                         upper: wp.array2d(dtype=wp.float64), cost: Cost, b: int, target: vec6d,
                         tension: wp.array2d(dtype=wp.float64)) -> int:  # fmt: skip
    """Solve one problem; 1 if A t = b to rounding and the cost is least, 0 if no such t was found.

    Call `set_cost` before.
    """
    for i in range(column.shape[1]):
        linearise(cost, b, i, cost.reference[b, i])
    solved = bounded_tensions(column, lower, upper, cost.middle, cost.softness, b, target, tension)
    if solved == 0 or is_quadratic(cost.choice):
        return solved
    for _step in range(NEWTON_STEPS_MAX):
        for i in range(column.shape[1]):
            cost.iterate[b, i] = tension[b, i]
            linearise(cost, b, i, tension[b, i])
        solved = bounded_tensions(
            column, lower, upper, cost.middle, cost.softness, b, target, tension
        )
        if solved == 0:
            return 0
        change = wp.float64(0.0)
        for i in range(column.shape[1]):
            step = wp.abs(tension[b, i] - cost.iterate[b, i])
            change = wp.max(change, step / cost.scale[b, i])
        if change <= NEWTON_CHANGE:
            return 1
        if change > SEARCH_CHANGE:
            a = step_share(cost, b, tension)
            for i in range(column.shape[1]):
                step = tension[b, i] - cost.iterate[b, i]
                tension[b, i] = cost.iterate[b, i] + a * step
    return wp.where(change <= SEARCH_CHANGE, 1, 0)


@wp.kernel
def distribute(
    column: wp.array2d(dtype=vec6d),
    target: wp.array(dtype=vec6d),
    lower: wp.array2d(dtype=wp.float64),
    upper: wp.array2d(dtype=wp.float64),
    cost: Cost,
    tension: wp.array2d(dtype=wp.float64),
    feasible: wp.array(dtype=int),
):
    """Distribute one wrench per thread."""
    b = wp.tid()
    set_cost(cost, lower, upper, b, wp.length(target[b]))
    feasible[b] = distributed_tensions(column, lower, upper, cost, b, target[b], tension)
