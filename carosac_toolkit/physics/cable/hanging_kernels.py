"""Single cables between two points, and the shape of hanging cables."""

import warp as wp

from carosac_toolkit.physics.cable.catenary_kernels import (
    ZERO,
    HungCable,
    catenary_span,
    guess_cable,
    guess_tension_vector,
    hang,
    settle,
)
from carosac_toolkit.physics.cable.tension_kernels import pull_down
from carosac_toolkit.physics.device_kernels import Cable, anchor_of

SETTLED_CLOSURE_MAX = wp.constant(
    wp.float64(1.0e-12)
)  # of the length: a cable that fits is left alone

wp.set_module_options({"enable_backward": False, "max_unroll": 1})


@wp.kernel
def solve_catenary(
    span: wp.array(dtype=wp.float64),
    rise: wp.array(dtype=wp.float64),
    length: wp.array(dtype=wp.float64),
    weight: wp.array(dtype=wp.float64),
    stiffness: wp.array(dtype=wp.float64),
    horizontal: wp.array(dtype=wp.float64),
    vertical_lower: wp.array(dtype=wp.float64),
    closure: wp.array(dtype=wp.float64),
    jacobian: wp.array(dtype=wp.mat22d),
    iterations: wp.array(dtype=int),
):
    """Solve one cable per thread, lower end at the origin, upper end at (span, 0, rise)."""
    b = wp.tid()
    cable = Cable()
    cable.exit_point = wp.vec3d(span[b], ZERO, rise[b])
    cable.weight_per_length = weight[b]
    cable.axial_stiffness = stiffness[b]
    origin = wp.vec3d()
    q = guess_tension_vector(cable.exit_point, length[b], weight[b], stiffness[b])
    size = length[b] + wp.abs(span[b]) + wp.abs(rise[b])
    s = settle(q, origin, length[b], cable, wp.float64(1.0e-11) * size, 100)
    steps = s.iterations
    best = wp.length(s.hanging.closure)
    for _polish in range(4):
        # Newton once more, for as long as it still gains: the floor is rounding.
        q = s.q - s.inverse * s.hanging.closure
        trial = settle(q, origin, length[b], cable, wp.float64(1.0e30), 0)
        if wp.length(trial.hanging.closure) < best:
            best = wp.length(trial.hanging.closure)
            s = trial
    force = s.hanging.force
    horizontal[b] = force[0]
    vertical_lower[b] = force[2]
    closure[b] = best
    jacobian[b] = wp.mat22d(s.inverse[0, 0], s.inverse[0, 2], s.inverse[2, 0], s.inverse[2, 2])
    iterations[b] = steps


@wp.func
def point_of(state: HungCable, q: wp.vec3d, cable: Cable, k: int, count: int):
    """Return the k-th of `count` points, evenly spaced in unstrained length, exit first."""
    part = state.free_length * wp.float64(k) / wp.float64(count - 1)
    span = catenary_span(q, part, cable.weight_per_length, cable.axial_stiffness)
    return state.tangent_point - span.reach


@wp.kernel
def cable_points(
    cables: wp.array2d(dtype=Cable),
    unstrained_length: wp.array2d(dtype=wp.float64),
    q: wp.array2d(dtype=wp.vec3d),
    points: wp.array3d(dtype=wp.vec3d),
):
    """Compute points along each free cable, evenly spaced in unstrained length, exit first."""
    b, i = wp.tid()
    cable = cables[wp.min(b, cables.shape[0] - 1), i]
    state = hang(q[b, i], wp.vec3d(), unstrained_length[b, i], cable)
    for k in range(points.shape[2]):
        points[b, i, k] = point_of(state, q[b, i], cable, k, points.shape[2])


@wp.kernel
def cables_of_tension(
    cables: wp.array2d(dtype=Cable),
    position: wp.array(dtype=wp.vec3d),
    rotation: wp.array(dtype=wp.mat33d),
    tension: wp.array2d(dtype=wp.float64),
    unstrained_length: wp.array2d(dtype=wp.float64),
    sag: wp.array2d(dtype=wp.float64),
    stretch: wp.array2d(dtype=wp.float64),
    closure: wp.array2d(dtype=wp.float64),
    mismatch: wp.array2d(dtype=wp.float64),
    taut: wp.array2d(dtype=int),
):
    """Solve one cable per thread that reaches its anchor point with a required tension."""
    b, i = wp.tid()
    cable = cables[wp.min(b, cables.shape[0] - 1), i]
    anchor = anchor_of(cable, position[b], rotation[b])
    pulling = pull_down(anchor, tension[b, i], cable)
    free = pulling.hanging.free_length
    span = catenary_span(pulling.q, free, cable.weight_per_length, cable.axial_stiffness)
    strain = wp.length(pulling.q) / cable.axial_stiffness
    unstrained_length[b, i] = pulling.unstrained_length
    sag[b, i] = free + span.stretch - wp.length(pulling.hanging.tangent_point - anchor)
    stretch[b, i] = span.stretch + cable.run_length * strain / (wp.float64(1.0) + strain)
    closure[b, i] = wp.length(pulling.hanging.closure)
    mismatch[b, i] = wp.abs(pulling.mismatch)
    taut[b, i] = pulling.taut


@wp.kernel
def hanging_points(
    cables: wp.array2d(dtype=Cable),
    position: wp.array(dtype=wp.vec3d),
    rotation: wp.array(dtype=wp.mat33d),
    unstrained_length: wp.array2d(dtype=wp.float64),
    tension: wp.array2d(dtype=wp.float64),
    q: wp.array2d(dtype=wp.vec3d),
    closure: wp.array2d(dtype=wp.float64),
    points: wp.array3d(dtype=wp.vec3d),
):
    """Hang one cable of known length per thread from its exit to its anchor at a pose."""
    b, i = wp.tid()
    cable = cables[wp.min(b, cables.shape[0] - 1), i]
    anchor = anchor_of(cable, position[b], rotation[b])
    length = unstrained_length[b, i]
    settled = settle(
        guess_cable(anchor, length, cable), anchor, length, cable, SETTLED_CLOSURE_MAX * length, 100
    )
    tension[b, i] = wp.length(settled.hanging.force)
    q[b, i] = settled.q
    closure[b, i] = wp.length(settled.hanging.closure)
    for k in range(points.shape[2]):
        points[b, i, k] = point_of(settled.hanging, settled.q, cable, k, points.shape[2])
