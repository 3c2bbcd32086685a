"""Friction of a cable on its pulley, in float64 Warp: the capstan's ratio of tensions.

A cable that slides over a wrap of theta, with a coefficient mu, has tensions on both sides whose
ratio is exp(mu theta) (Euler, Eytelwein). What is left of the tension T at the exit stretches the
run to the winch,

    T exp(-mu theta b) = EA e / run,

by e, with b = 1 where cable slides out and -1 where it slides in. In between bristles hold it, as
in `friction_kernels`: with the slip s of a time step, which is what the winch pays out and what the
run stretches more, and a = |s| / d,

    b' = exp(-a) b + (1 - exp(-a)) / a s / d.

They slide once the slip is a tenth of the run's stretch, d: what a smaller share would be is below
what is known of a run. At an eyelet mu stands for mu theta. Where nothing is known of what was
before, b is 0, as in statics.

References:
    Johnson, *Contact Mechanics*, 1985, 8.2 (belt drives).
    Dahl, *A solid friction model*, The Aerospace Corporation, 1968.
"""

import warp as wp

from carosac_toolkit.physics.cable.catenary_kernels import ONE, ZERO
from carosac_toolkit.physics.device_kernels import Cable

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

SLIDING_SHARE = wp.constant(wp.float64(0.1))  # of the run's stretch: slip after which it slides
STRETCH_MIN = wp.constant(wp.float64(1.0e-12))  # of the run: no division
RUN_STEPS_MAX = wp.constant(60)  # steps of Newton or bisection
RUN_TOLERANCE = wp.constant(wp.float64(1.0e-14))  # of the largest stretch
SMALL_SLIP = wp.constant(wp.float64(1.0e-6))  # of d, below which the series is exact to rounding


@wp.struct
class Run:
    """The run of a cable at the end of a time step."""

    bend: wp.float64  # of the bristles, -1 to 1
    stretch: wp.float64  # [m]
    length: wp.float64  # unstrained, that the winch has paid out [m]
    known: int  # 0: of the past only the bend is known, and nothing slips yet


@wp.struct
class PulledRun:
    """A run at a trial."""

    run: Run
    slope: wp.float64  # of what `stretched` solves, by the stretch
    miss: wp.float64  # of it [m]


@wp.func
def grips(cable: Cable) -> bool:
    """Return true if the friction of the cable on its pulley shows: it has a run that stretches."""
    return cable.capstan_friction > ZERO and cable.run_length > ZERO


@wp.func
def bend_gain(a: wp.float64, kept: wp.float64) -> wp.float64:
    """Return (1 - kept) / a for a >= 0, of which kept = exp(-a)."""
    if a > SMALL_SLIP:
        return (ONE - kept) / a
    return ONE - wp.float64(0.5) * a


@wp.func
def capstan_exponent(cable: Cable, wrap: wp.float64) -> wp.float64:
    """Return mu theta of a cable that wraps its pulley by an angle [rad]; mu at an eyelet."""
    if cable.pulley_radius > ZERO:
        return cable.capstan_friction * wp.max(wrap, ZERO)
    return cable.capstan_friction


@wp.func
def stretched(cable: Cable, run: Run, length: wp.float64, exponent: wp.float64, alone: wp.float64,
              pulled: wp.float64, right: wp.float64) -> PulledRun:  # fmt: skip
    """Solve alone e + pulled e exp(exponent b(e)) = right for the stretch e of a run.

    The left side grows with e. The second term is `pulled` run / EA times the tension at the exit.

    Args:
        cable: The cable; see `grips`.
        run: At the start of the time step.
        length: Unstrained, that the winch has paid out at its end [m].
        exponent: See `capstan_exponent`.
        alone: >= 0.
        pulled: > 0.
        right: [m]; the run is slack where it is not positive.
    """
    out = PulledRun()
    slide = SLIDING_SHARE * wp.max(run.stretch, STRETCH_MIN * cable.run_length)
    paid = length - run.length - run.stretch
    low = ZERO
    high = wp.max(right, ZERO) / (alone + pulled * wp.exp(-exponent))
    most = high
    e = wp.clamp(wp.max(right, ZERO) / (alone + pulled), low, high)
    step = high - low
    count = int(0)
    going = bool(True)
    while going:
        out.run.bend = run.bend
        growth = wp.float64(0.0)
        if run.known == 1:
            slip = paid + e
            a = wp.abs(slip) / slide
            kept = wp.exp(-a)
            out.run.bend = kept * run.bend + bend_gain(a, kept) * slip / slide
            growth = kept * (ONE - wp.sign(slip) * run.bend) / slide
        ratio = wp.exp(exponent * out.run.bend)
        out.slope = alone + pulled * ratio * (ONE + e * exponent * growth)
        out.run.stretch = e
        out.miss = alone * e + pulled * e * ratio - right
        if out.miss > ZERO:
            high = e
        else:
            low = e
        move = -out.miss / out.slope
        inside = e + move >= low and e + move <= high
        if not (inside and wp.abs(move) < wp.float64(0.5) * wp.abs(step)):
            move = wp.float64(0.5) * (low + high) - e  # where the slope changes its side, it cycles
        step = move
        e += move
        count += 1
        going = wp.abs(move) > RUN_TOLERANCE * most and count < RUN_STEPS_MAX
    out.run.length = length
    out.run.known = 1
    return out
