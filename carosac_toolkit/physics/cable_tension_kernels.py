"""One cable of given tension: the length and shape that make it pull so hard at the platform."""

import warp as wp

from carosac_toolkit.physics.cable_kernels import (
    HALF,
    ONE,
    ZERO,
    Cable,
    Hanging,
    hang,
    inverse33,
)
from carosac_toolkit.physics.start_kernels import straight_to

wp.set_module_options({"enable_backward": False, "max_unroll": 1})


@wp.struct
class Pulling:
    """A cable that pulls with a given tension at the platform."""

    q: wp.vec3d  # tension vector at the exit [N]
    unstrained_length: wp.float64  # [m]
    hanging: Hanging
    force_t: wp.vec3d  # d force / d tension
    stiffness: wp.mat33d  # -d force / d anchor at constant tension [N/m]
    mismatch: wp.float64  # [N] left between asked and reached tension
    iterations: int


@wp.func
def guess_pull(anchor: wp.vec3d, tension: wp.float64, cable: Cable) -> Pulling:
    """First guess: straight cable, half its weight at each end."""
    straight = straight_to(cable, anchor)
    strained = ONE + tension / cable.axial_stiffness
    out = Pulling()
    length = (straight.length - cable.run_length * (strained - ONE)) / strained
    out.unstrained_length = wp.max(length, wp.float64(1.0e-3) * straight.length)
    w_l = cable.weight_per_length * out.unstrained_length
    out.q = tension * straight.unit + wp.vec3d(ZERO, ZERO, HALF * w_l)
    return out


@wp.func
def pull(start: Pulling, anchor: wp.vec3d, tension: wp.float64, cable: Cable,
         tolerance: wp.float64, limit: int) -> Pulling:  # fmt: skip
    """Newton on closure and tension together, from a guess; steps limited by a factor of two."""
    q = start.q
    length = start.unstrained_length
    z = wp.vec3d(ZERO, ZERO, cable.weight_per_length)
    out = Pulling()
    count = int(0)
    going = bool(True)
    while going:
        state = hang(q, anchor, length, cable)
        inverse = inverse33(state.closure_q)
        size = wp.length(state.force)
        unit = state.force / size
        per_closure = inverse * state.closure
        per_length = inverse * state.closure_l
        # d force / d length at closed geometry
        force_l = -(state.force_q * per_length) - z
        out.mismatch = tension - size
        change = (out.mismatch + wp.dot(unit, state.force_q * per_closure)) / wp.dot(unit, force_l)
        k = state.force_q * inverse
        out.force_t = force_l / wp.dot(unit, force_l)
        out.stiffness = k - wp.outer(out.force_t, wp.transpose(k) * unit)
        out.q = q
        out.unstrained_length = length
        out.hanging = state
        going = count < limit and (
            wp.length(state.closure) > tolerance * length
            or wp.abs(out.mismatch) > wp.float64(1.0e2) * tolerance * tension
        )
        if going:
            change = wp.clamp(change, -HALF * length, length)
            q = q - per_closure - per_length * change
            length += change
            count += 1
    out.iterations = count
    return out
