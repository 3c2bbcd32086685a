"""Warp kernel of `learned.length_map`: lengths of rest at displaced targets; float64."""

import warp as wp

from carosac_toolkit.physics.cable.straight_line_kernels import straight_cable

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

f64 = wp.float64
vec3 = wp.vec3d
mat33 = wp.mat33d


@wp.func
def in_box(point: vec3, center: vec3, half: vec3):
    """Return a point of W as shares of the box from its middle, clipped to its border."""
    share = wp.cw_div(point - center, half)
    one = vec3(f64(1.0), f64(1.0), f64(1.0))
    return wp.min(wp.max(share, -one), one)


@wp.func
def chebyshev(order: int, x: f64):
    """Return T_order(x) of the Chebyshev polynomials."""
    before = f64(1.0)
    value = x
    for _ in range(order - 1):
        later = f64(2.0) * x * value - before
        before = value
        value = later
    return wp.where(order == 0, f64(1.0), value)


@wp.kernel
def lengths_of_rest(
    target: wp.array(dtype=vec3),
    offset: wp.array(dtype=vec3),
    push: wp.array(dtype=vec3),
    degree: int,
    center: vec3,
    half: vec3,
    soft: wp.array(dtype=mat33),
    extra: wp.array2d(dtype=f64),
    rotation: mat33,
    exit_point: wp.array(dtype=vec3),
    anchor: wp.array(dtype=vec3),
    radius: wp.array(dtype=f64),
    axis: wp.array(dtype=vec3),
    place: wp.array(dtype=vec3),
    length: wp.array2d(dtype=f64),
):
    """Move targets by push and offset, and find lengths of rest there; one thread each.

    Args:
        target: In W [m], shape (B,).
        offset: In W [m], shape (B,).
        push: [m/s^2], shape (B,).
        degree: Largest total degree of the products, K of them, in lexicographic order.
        center: Middle of the box in W [m].
        half: Half its edges [m].
        soft: Coefficients of the softness [s^2], shape (K,).
        extra: Those of what lengths of rest have beyond straight lines [m], shape (K, n).
        rotation: From P to W, of straight lines.
        exit_point: Of each cable in W [m], shape (n,).
        anchor: In P [m], shape (n,).
        radius: Of its pulley [m], shape (n,).
        axis: See `straight_cable`, shape (n,).
        place: Displaced targets in W [m], shape (B,).
        length: [m], shape (B, n).
    """
    b = wp.tid()
    x = in_box(target[b], center, half)
    moved = mat33()
    term = int(0)
    for i in range(degree + 1):
        ti = chebyshev(i, x[0])
        for j in range(degree + 1 - i):
            tij = ti * chebyshev(j, x[1])
            for k in range(degree + 1 - i - j):
                moved += tij * chebyshev(k, x[2]) * soft[term]
                term += 1
    there = target[b] + offset[b] + moved * push[b]
    place[b] = there
    for cable in range(exit_point.shape[0]):
        relative = there + rotation * anchor[cable] - exit_point[cable]
        span, _wrap, _unit, _bend, _inside = straight_cable(relative, radius[cable], axis[cable])
        length[b, cable] = span
    x = in_box(there, center, half)
    term = int(0)
    for i in range(degree + 1):
        ti = chebyshev(i, x[0])
        for j in range(degree + 1 - i):
            tij = ti * chebyshev(j, x[1])
            for k in range(degree + 1 - i - j):
                value = tij * chebyshev(k, x[2])
                for cable in range(exit_point.shape[0]):
                    length[b, cable] += value * extra[term, cable]
                term += 1
