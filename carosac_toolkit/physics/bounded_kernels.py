"""Least squared tensions within limits for a given wrench, any number of cables.

    minimise  1/2 sum_i (t_i - m_i)^2   subject to   A t = b,   lower <= t <= upper

Its dual has six unknowns whatever n is: t_i = clip(m_i + A_i . y), and A t(y) = b is the zero of
the gradient of a concave piecewise quadratic function. Newton on it with a line search ends after
finitely many changes of the set of cables that are inside their limits.
"""

import warp as wp

from carosac_toolkit.physics.cable_kernels import HALF, ZERO, mat66d, vec6d
from carosac_toolkit.physics.platform_kernels import factorise, solve_factored

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

STEPS = wp.constant(200)
SEARCH = wp.constant(80)
PRECISION = wp.constant(wp.float64(1.0e-13))


@wp.struct
class Clipped:
    """Tensions of one dual point."""

    wrench: vec6d  # A t
    gram: mat66d  # sum of A_i A_i^T over the cables inside their limits
    size: wp.float64  # sum of t, the scale of rounding


@wp.func
def clipped_tensions(column: wp.array2d(dtype=vec6d), lower: wp.array2d(dtype=wp.float64),
                     upper: wp.array2d(dtype=wp.float64), middle: wp.array2d(dtype=wp.float64),
                     b: int, dual: vec6d, tension: wp.array2d(dtype=wp.float64)) -> Clipped:  # fmt: skip
    """Tensions t(y), their wrench and the slope of the wrench."""
    out = Clipped()
    for i in range(column.shape[1]):
        a = column[b, i]
        t = middle[b, i] + wp.dot(a, dual)
        if t > lower[b, i] and t < upper[b, i]:
            out.gram = out.gram + wp.outer(a, a)
        t = wp.clamp(t, lower[b, i], upper[b, i])
        tension[b, i] = t
        out.wrench = out.wrench + t * a
        out.size += wp.abs(t)
    return out


@wp.func
def bounded_tensions(column: wp.array2d(dtype=vec6d), lower: wp.array2d(dtype=wp.float64),
                     upper: wp.array2d(dtype=wp.float64), middle: wp.array2d(dtype=wp.float64),
                     b: int, target: vec6d, tension: wp.array2d(dtype=wp.float64)) -> int:  # fmt: skip
    """Solve one problem; 1 where A t = b to rounding, 0 where no such t was found."""
    dual = vec6d()
    left = wp.float64(0.0)
    for _step in range(STEPS):
        here = clipped_tensions(column, lower, upper, middle, b, dual, tension)
        rest = target - here.wrench
        if wp.length(rest) <= PRECISION * (wp.length(target) + here.size):
            return 1
        gram = here.gram
        ridge = wp.float64(1.0e-12) + wp.float64(1.0e-14) * wp.trace(gram)
        for i in range(6):
            gram[i, i] = gram[i, i] + ridge
        f = factorise(gram)
        direction = solve_factored(f.ldl, rest)
        slope = wp.dot(rest, direction)
        # Along the direction the dual's slope falls from `slope`; stop where it is small.
        a = wp.float64(1.0)
        left = wp.float64(0.0)
        right = wp.float64(-1.0)
        for _search in range(SEARCH):
            there = clipped_tensions(
                column, lower, upper, middle, b, dual + a * direction, tension
            )
            now = wp.dot(direction, target - there.wrench)
            if now > HALF * slope:
                left = a
                if right < ZERO:
                    a = wp.float64(4.0) * a
                else:
                    a = HALF * (left + right)
            elif now < -HALF * slope:
                right = a
                if left == ZERO:
                    a = wp.float64(0.1) * a
                else:
                    a = HALF * (left + right)
            else:
                break
        if right < ZERO and left > wp.float64(1.0e20):
            return 0  # the dual rises without end: no tensions within the limits
        dual = dual + a * direction
    return 0


@wp.kernel
def distribute(
    column: wp.array2d(dtype=vec6d),
    target: wp.array(dtype=vec6d),
    lower: wp.array2d(dtype=wp.float64),
    upper: wp.array2d(dtype=wp.float64),
    middle: wp.array2d(dtype=wp.float64),
    tension: wp.array2d(dtype=wp.float64),
    feasible: wp.array(dtype=int),
):
    """One wrench per thread."""
    b = wp.tid()
    feasible[b] = bounded_tensions(column, lower, upper, middle, b, target[b], tension)
