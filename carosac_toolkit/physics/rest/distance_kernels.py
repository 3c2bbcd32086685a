"""Smallest distance of two cables, each a chain of straight pieces."""

import warp as wp

from carosac_toolkit.physics.cable.catenary_kernels import DIVISION_FLOOR, ONE, ZERO

wp.set_module_options({"enable_backward": False, "max_unroll": 1})


@wp.func
def piece_distance(p: wp.vec3d, u: wp.vec3d, q: wp.vec3d, v: wp.vec3d) -> wp.float64:
    """Return the distance of the segments p + s u and q + t v, s and t from 0 to 1.

    References:
        Ericson, *Real-Time Collision Detection*, Morgan Kaufmann, 2005, section 5.1.9.
    """
    w = p - q
    a = wp.dot(u, u) + DIVISION_FLOOR
    e = wp.dot(v, v) + DIVISION_FLOOR
    b = wp.dot(u, v)
    c = wp.dot(u, w)
    f = wp.dot(v, w)
    s = wp.float64(0.0)
    area = a * e - b * b
    if area > wp.float64(1.0e-14) * a * e:
        s = wp.clamp((b * f - c * e) / area, ZERO, ONE)
    t = (b * s + f) / e
    if t < ZERO:
        t = wp.float64(0.0)
        s = wp.clamp(-c / a, ZERO, ONE)
    elif t > ONE:
        t = wp.float64(1.0)
        s = wp.clamp((b - c) / a, ZERO, ONE)
    return wp.length(w + s * u - t * v)


@wp.kernel
def smallest_distances(
    points: wp.array3d(dtype=wp.vec3d),
    pairs: wp.array2d(dtype=int),
    distance: wp.array2d(dtype=wp.float64),
):
    """Compute one pose and one pair of cables per thread."""
    b, k = wp.tid()
    i = pairs[k, 0]
    j = pairs[k, 1]
    least = wp.float64(1.0e300)
    for m in range(points.shape[2] - 1):
        p = points[b, i, m]
        u = points[b, i, m + 1] - p
        for o in range(points.shape[2] - 1):
            q = points[b, j, o]
            least = wp.min(least, piece_distance(p, u, q, points[b, j, o + 1] - q))
    distance[b, k] = least
