"""Least squared tensions within limits for a given wrench, any number of cables.

    minimise  1/2 sum_i (t_i - m_i)^2 / s_i   subject to   A t = b,   lower <= t <= upper

Its dual has six unknowns whatever n is: t_i = clip(m_i + s_i A_i . y), and A t(y) = b is the zero
of the gradient of a concave piecewise quadratic function. Newton on it with a line search ends
after finitely many changes of the set of cables that are inside their limits.
"""

import warp as wp

from carosac_toolkit.physics.cable.catenary_kernels import DIVISION_FLOOR, HALF, ZERO, mat66d, vec6d
from carosac_toolkit.physics.rest.platform_kernels import factorise, solve_factored

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

DUAL_STEPS_MAX = wp.constant(100)
LINE_SEARCH_STEPS_MAX = wp.constant(80)
WRENCH_TOLERANCE = wp.constant(wp.float64(1.0e-13))
GRAM_RIDGE_SINGULAR = wp.constant(wp.float64(1.0e-5))
GRAM_RIDGE_REGULAR = wp.constant(wp.float64(1.0e-10))


@wp.struct
class Clipped:
    """Tensions of one dual point."""

    wrench: vec6d  # A t
    gram: mat66d  # sum of s_i A_i A_i^T over the cables inside their limits
    free: int  # how many of them there are
    size: wp.float64  # sum of t, the scale of rounding


@wp.func
def clipped_tensions(column: wp.array2d(dtype=vec6d), lower: wp.array2d(dtype=wp.float64),
                     upper: wp.array2d(dtype=wp.float64), middle: wp.array2d(dtype=wp.float64),
                     softness: wp.array2d(dtype=wp.float64), b: int, dual: vec6d,
                     tension: wp.array2d(dtype=wp.float64)) -> Clipped:  # fmt: skip
    """Compute tensions t(y), their wrench and the slope of the wrench."""
    out = Clipped()
    for i in range(column.shape[1]):
        a = column[b, i]
        t = middle[b, i] + softness[b, i] * wp.dot(a, dual)
        if t > lower[b, i] and t < upper[b, i]:
            out.gram = out.gram + softness[b, i] * wp.outer(a, a)
            out.free += 1
        t = wp.clamp(t, lower[b, i], upper[b, i])
        tension[b, i] = t
        out.wrench = out.wrench + t * a
        out.size += wp.abs(t)
    return out


@wp.func
def search_length(column: wp.array2d(dtype=vec6d), lower: wp.array2d(dtype=wp.float64),
                  upper: wp.array2d(dtype=wp.float64), middle: wp.array2d(dtype=wp.float64),
                  softness: wp.array2d(dtype=wp.float64), b: int, target: vec6d, dual: vec6d,
                  direction: vec6d, slope: wp.float64,
                  tension: wp.array2d(dtype=wp.float64)) -> wp.float64:  # fmt: skip
    """Step length at which the dual's slope has fallen to a tenth; infinite where it never does."""
    a = wp.float64(1.0)
    left = wp.float64(0.0)
    right = wp.float64(-1.0)
    for _search in range(LINE_SEARCH_STEPS_MAX):
        there = clipped_tensions(
            column, lower, upper, middle, softness, b, dual + a * direction, tension
        )
        now = wp.dot(direction, target - there.wrench)
        if now > wp.float64(0.1) * slope:
            left = a
            a = wp.where(right < ZERO, wp.float64(4.0) * a, HALF * (left + right))
        elif now < -wp.float64(0.1) * slope:
            right = a
            a = wp.where(left == ZERO, wp.float64(0.1) * a, HALF * (left + right))
        else:
            break
    return a


@wp.func
def bounded_tensions(column: wp.array2d(dtype=vec6d), lower: wp.array2d(dtype=wp.float64),
                     upper: wp.array2d(dtype=wp.float64), middle: wp.array2d(dtype=wp.float64),
                     softness: wp.array2d(dtype=wp.float64), b: int, target: vec6d,
                     tension: wp.array2d(dtype=wp.float64)) -> int:  # fmt: skip
    """Solve one problem; 1 where A t = b to rounding, 0 where no such t was found."""
    whole = mat66d()
    free_wrench = vec6d()
    for i in range(column.shape[1]):
        whole = whole + softness[b, i] * wp.outer(column[b, i], column[b, i])
        free_wrench = free_wrench + middle[b, i] * column[b, i]
    for i in range(6):
        whole[i, i] = whole[i, i] + wp.float64(1.0e-13) * wp.trace(whole) + DIVISION_FLOOR
    # Start at the answer without limits.
    f = factorise(whole)
    dual = solve_factored(f.ldl, target - free_wrench)
    for _step in range(DUAL_STEPS_MAX):
        here = clipped_tensions(column, lower, upper, middle, softness, b, dual, tension)
        rest = target - here.wrench
        if wp.length(rest) <= WRENCH_TOLERANCE * (wp.length(target) + here.size):
            return 1
        # With fewer than six cables inside their limits the others lend a little of their slope.
        f = factorise(
            here.gram + wp.where(here.free < 6, GRAM_RIDGE_SINGULAR, GRAM_RIDGE_REGULAR) * whole
        )
        direction = solve_factored(f.ldl, rest)
        a = search_length(
            column, lower, upper, middle, softness, b, target, dual, direction,
            wp.dot(rest, direction), tension,
        )  # fmt: skip
        if a > wp.float64(1.0e12):
            return 0  # the dual rises without end: no tensions within the limits
        dual = dual + a * direction
    return 0
