"""One cable of known tension at the platform: its length and shape."""

import warp as wp

from carosac_toolkit.physics.cable.catenary_kernels import (
    HALF,
    ONE,
    TWO,
    ZERO,
    HungCable,
    hang,
    inverse33,
)
from carosac_toolkit.physics.cable.straight_line_kernels import straight_to
from carosac_toolkit.physics.device_kernels import Cable

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

LEAST_TENSION_FACTOR = wp.constant(
    wp.float64(1.3)
)  # over the least tension, where length and tension part ways
LEAST_TENSION_FACTOR_WIDE = wp.constant(wp.float64(4.0))


@wp.struct
class Pulling:
    """A cable that pulls with a given tension at the platform."""

    q: wp.vec3d  # tension vector at the exit [N]
    unstrained_length: wp.float64  # [m]
    hanging: HungCable
    force_t: wp.vec3d  # d force / d tension
    stiffness: wp.mat33d  # -d force / d anchor at constant tension [N/m]
    mismatch: wp.float64  # [N] left between asked and reached tension
    taut: int  # 1 where paying out loosens the cable; 0 on the deeply sagging branch
    iterations: int


@wp.func
def guess_pull(anchor: wp.vec3d, tension: wp.float64, cable: Cable) -> Pulling:
    """Guess a straight cable, half its weight at each end."""
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
    """Solve closure and tension together by Newton; steps limited by a factor of two."""
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
        out.taut = wp.where(wp.dot(unit, force_l) < ZERO, 1, 0)
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


@wp.func
def end_tension(x: wp.float64, span: wp.float64, rise: wp.float64, w: wp.float64) -> wp.float64:
    """Return the tension at the platform of an inextensible catenary, x = w span / (2 H)."""
    bulge = span * wp.sinh(x) / x
    length = wp.sqrt(rise * rise + bulge * bulge)
    horizontal = w * span / (TWO * x)
    vertical = HALF * w * (rise / wp.tanh(x) - length)
    return wp.sqrt(horizontal * horizontal + vertical * vertical)


@wp.func
def least_tension(anchor: wp.vec3d, cable: Cable) -> wp.float64:
    """Return the least tension at the platform with which a cable can hang there at all.

    Looser and tighter cables both pull harder: golden section over the logarithm of x.
    """
    d = straight_to(cable, anchor)
    reach = d.unit * d.length
    span = wp.sqrt(reach[0] * reach[0] + reach[1] * reach[1]) + wp.float64(1.0e-9) * d.length
    w = cable.weight_per_length
    left = wp.log(wp.float64(1.0e-3))
    right = wp.log(wp.float64(20.0))
    golden = wp.float64(0.6180339887498949)
    for _i in range(22):
        a = right - golden * (right - left)
        b = left + golden * (right - left)
        if end_tension(wp.exp(a), span, reach[2], w) < end_tension(wp.exp(b), span, reach[2], w):
            right = b
        else:
            left = a
    return end_tension(wp.exp(left), span, reach[2], w)


@wp.func
def lowest_allowed(
    anchor: wp.vec3d, cable: Cable, weight: wp.float64, margin: wp.float64
) -> wp.float64:
    """Return the lower tension limit [N]: the robot's, or `margin` times the least possible."""
    lowest = wp.max(cable.tension_min, wp.float64(1.0e-6) * weight)
    # Never more than 1.3 times the weight of the straight cable: often no need to look closer.
    most = wp.float64(1.3) * cable.weight_per_length * straight_to(cable, anchor).length
    if lowest < margin * most:
        lowest = wp.max(lowest, margin * least_tension(anchor, cable))
    return lowest


@wp.func
def pull_down(anchor: wp.vec3d, tension: wp.float64, cable: Cable) -> Pulling:
    """Return the taut cable of a tension, followed down from one at which it hardly sags."""
    t = wp.max(tension, TWO * cable.weight_per_length * straight_to(cable, anchor).length)
    out = pull(guess_pull(anchor, t, cable), anchor, t, cable, wp.float64(1.0e-14), 60)
    while t > tension:
        t = wp.max(wp.float64(0.9) * t, tension)
        out = pull(out, anchor, t, cable, wp.float64(1.0e-14), 60)
    return out
