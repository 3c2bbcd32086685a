"""How a cable without nodes pulls at its anchor point: a catenary, or a straight spring."""

import warp as wp

from carosac_toolkit.physics.cable.catenary_kernels import (
    ONE,
    ZERO,
    SettledCable,
    guess_cable,
    pulley_wrap,
    settle,
)
from carosac_toolkit.physics.cable.straight_line_kernels import straight_cable
from carosac_toolkit.physics.device_kernels import Cable
from carosac_toolkit.physics.motion.capstan_kernels import Run, capstan_exponent, grips, stretched
from carosac_toolkit.physics.rest.platform_kernels import cable_stiffness

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

MOTION_CABLE_STEPS_MAX = wp.constant(60)  # steps of one cable
LOOSE_CLOSURE_MAX = wp.constant(
    wp.float64(1.0e-3)
)  # of the typical length: a larger closure is closed first
TIGHT_CLOSURE_MAX = wp.constant(wp.float64(1.0e-12))
FIRST_ORDER_CORRECTION_MAX = wp.constant(
    wp.float64(0.3)
)  # of q: a larger correction is not of first order any more
RUN_CORRECTIONS_MAX = wp.constant(8)  # of what friction on the pulley keeps from the run
RUN_CORRECTION_MIN = wp.constant(wp.float64(1.0e-10))  # of the typical length


@wp.struct
class Pull:
    """Action of one cable on its anchor point."""

    force: wp.vec3d  # [N]
    stiffness: wp.mat33d  # -d force / d anchor within a time step, symmetric [N/m]
    gap: wp.float64  # [m]
    q: wp.vec3d
    inverse: wp.mat33d
    run: Run


@wp.func
def closed(cable: Cable, q: wp.vec3d, anchor: wp.vec3d, length: wp.float64,
           size: wp.float64) -> SettledCable:  # fmt: skip
    """Close a catenary so far that a correction of first order closes it altogether."""
    s = settle(q, anchor, length, cable, LOOSE_CLOSURE_MAX * size, MOTION_CABLE_STEPS_MAX)
    rest = s.inverse * s.hanging.closure
    if not wp.length(rest) < FIRST_ORDER_CORRECTION_MAX * wp.length(s.q):
        s = settle(
            guess_cable(anchor, length, cable),
            anchor,
            length,
            cable,
            TIGHT_CLOSURE_MAX * size,
            MOTION_CABLE_STEPS_MAX,
        )
    return s


@wp.struct
class GrippedCable:
    """A catenary whose run is held by friction on its pulley."""

    settled: SettledCable
    run: Run
    stiffer: wp.float64  # along it, than with a run that slips freely [N/m]
    gap: wp.float64  # that its run misses [m]


@wp.func
def gripped_cable(cable: Cable, run: Run, q: wp.vec3d, anchor: wp.vec3d, length: wp.float64,
                  size: wp.float64) -> GrippedCable:  # fmt: skip
    """Close a catenary with the run that friction on its pulley leaves.

    By what the run is stretched more than without, there is more cable to hang.
    """
    out = GrippedCable()
    soft = cable.run_length / cable.axial_stiffness
    nearer = q
    shift = wp.float64(0.0)
    count = int(0)
    going = bool(True)
    while going:
        tension = wp.length(nearer)
        strained = ONE + tension / cable.axial_stiffness
        exponent = capstan_exponent(cable, pulley_wrap(nearer, cable).angle)
        pulled = stretched(cable, run, length, exponent, ZERO, ONE, soft * tension)
        out.run = pulled.run
        miss = pulled.run.stretch - soft * tension - shift * strained
        less = soft / pulled.slope - soft
        along = wp.float64(0.0)
        if count > 0:
            n = wp.normalize(out.settled.hanging.force)
            k = cable_stiffness(out.settled.hanging, out.settled.inverse)
            along = wp.dot(n, k * n)
            out.stiffer = -less * along * along / (ONE + less * along)
        out.gap = wp.abs(miss) + wp.abs(pulled.miss)
        going = count == 0 or (out.gap > RUN_CORRECTION_MIN * size and count < RUN_CORRECTIONS_MAX)
        if going:
            shift += miss / (strained + less * along)
            out.settled = closed(cable, nearer, anchor, length + shift, size)
            nearer = out.settled.q - out.settled.inverse * out.settled.hanging.closure
        count += 1
    return out


@wp.func
def sagging_pull(cable: Cable, run: Run, q: wp.vec3d, anchor: wp.vec3d, velocity: wp.vec3d,
                 length: wp.float64, rate: wp.float64, reach: wp.float64,
                 size: wp.float64) -> Pull:  # fmt: skip
    """Evaluate an elastic catenary with axial damping: damping / EA times the rate of tension.

    What friction on the pulley keeps from the run, or adds to it, is cable that hangs or does not.
    """
    out = Pull()
    s = SettledCable()
    stiffer = wp.float64(0.0)
    if grips(cable):
        gripped = gripped_cable(cable, run, q, anchor, length, size)
        s = gripped.settled
        stiffer = gripped.stiffer
        out.run = gripped.run
        out.gap = gripped.gap
    else:
        s = closed(cable, q, anchor, length, size)
    rest = s.inverse * s.hanging.closure
    force = s.hanging.force - s.hanging.force_q * rest
    n = wp.normalize(force)
    k = cable_stiffness(s.hanging, s.inverse)
    out.gap = wp.max(out.gap, wp.length(s.hanging.closure))
    out.q = s.q - rest
    out.inverse = s.inverse
    paid = s.hanging.force_q * (s.inverse * s.hanging.closure_l)  # -d force / d length, but weight
    along = -wp.dot(n, k * velocity) - rate * (
        wp.dot(n, paid) + cable.weight_per_length * n[2]
    )  # rate of the tension [N/s]
    time = cable.axial_damping / cable.axial_stiffness
    out.force = force + (time * along) * n
    out.stiffness = k + (stiffer + time / reach * wp.dot(n, k * n)) * wp.outer(n, n)
    return out


@wp.func
def straight_pull(cable: Cable, run: Run, anchor: wp.vec3d, velocity: wp.vec3d, length: wp.float64,
                  rate: wp.float64, reach: wp.float64) -> Pull:  # fmt: skip
    """Evaluate a straight massless spring that does not push, with axial damping."""
    span, wrap, unit, bend, _valid = straight_cable(
        anchor - cable.exit_point, cable.pulley_radius, cable.swivel_axis
    )
    whole = length + cable.run_length
    out = Pull()
    elastic = cable.axial_stiffness * (span - length)  # over `whole`: the tension
    stiffness = cable.axial_stiffness
    if grips(cable):
        exponent = capstan_exponent(cable, wrap)
        pulled = stretched(
            cable, run, length, exponent, ONE, length / cable.run_length, span - length
        )
        out.run = pulled.run
        out.gap = wp.abs(pulled.miss)
        elastic = (elastic - cable.axial_stiffness * pulled.run.stretch) * whole / length
        stiffness = cable.axial_stiffness * (ONE - ONE / pulled.slope) * whole / length
    tension = (elastic + cable.axial_damping * (wp.dot(unit, velocity) - rate)) / whole
    if span > length and tension > ZERO:
        k = (stiffness + cable.axial_damping / reach) / whole
        out.force = -tension * unit
        out.stiffness = k * wp.outer(unit, unit) + tension * bend
    return out
