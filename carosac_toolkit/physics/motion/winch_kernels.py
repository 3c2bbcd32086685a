"""Winches in float64 Warp: response of wound lengths to commands, and the build-up of drums.

The drive asks for a rate of the cable by a PID law with the error e = target - length,

    wish = (e + integral_rate * integral(e) + derivative_time * de/dt) / lag,

of which the plain first-order lag is the case without integral and derivative. A command is held,
so de/dt is minus the rate. The rate that follows is meant, not the one before: solved for it,

    wish = (e + integral_rate * integral(e)) / (lag + derivative_time).

Acceleration and speed are limited; the integral stands still while either limit acts.

A drum of radius r whose squared radius falls by `buildup` per length paid out, from `drum_radius`
at length 0 (cable fully wound in), has dr/d(angle) = -buildup / 2 and thus

    length = drum_radius * angle - buildup * angle^2 / 4.

A cable that bends round drum and pulleys, a gear with play, a belt: they pay out less than the drum
has turned for while it pays out, by the hysteresis h at most, and more while it winds in,

    length = wound - h lag,    d(lag) = (d(wound) - lag |d(wound)|) / (2 h),

which is Dahl's law: monotone, at rest for a moment at each reversal, and the same at every speed.
"""

import warp as wp

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

f64 = wp.float64

ZERO = wp.constant(wp.float64(0.0))


@wp.struct
class Winch:
    """One winch: its drive, and its drum as it is and as the drive believes it to be."""

    lag: wp.float64  # [s]
    step_max: wp.float64  # longest inner step [s]
    speed_max: wp.float64  # [m/s]
    acceleration_max: wp.float64  # [m/s^2]
    hysteresis: wp.float64  # of the true length against what the drum has turned for [m]
    integral_rate: wp.float64  # [1/s]; 0: no integral
    derivative_time: wp.float64  # [s]
    drum_radius: wp.float64  # at length 0 [m]; 0: no drum known, lengths are commanded directly
    drum_buildup: wp.float64  # decrease of the squared radius per length paid out [m]
    believed_radius: wp.float64  # [m]
    believed_buildup: wp.float64  # [m]


@wp.struct
class WinchState:
    """Changing values of a winch."""

    length: wp.float64  # true unstrained length [m]
    rate: wp.float64  # of that length [m/s]
    wound: wp.float64  # what the drum has turned for [m]: the length, but for the hysteresis
    wound_rate: wp.float64  # of that [m/s]
    lag: wp.float64  # of the length behind it, in hystereses, -1 to 1
    integral: wp.float64  # of target - length over time [m s]


@wp.func
def drum_angle(radius: wp.float64, buildup: wp.float64, length: wp.float64) -> wp.float64:
    """Return the angle [rad] at which a drum has paid out a length [m]; exact without build-up."""
    left = wp.max(radius * radius - buildup * length, ZERO)
    return f64(2.0) * length / (radius + wp.sqrt(left))


@wp.func
def paid_out(radius: wp.float64, buildup: wp.float64, angle: wp.float64) -> wp.float64:
    """Return the length [m] that a drum has paid out after an angle [rad]."""
    return angle * (radius - f64(0.25) * buildup * angle)


@wp.func
def wound_length(winch: Winch, command: wp.float64) -> wp.float64:
    """Return the true length [m] at the angle by which the believed drum pays out a command [m]."""
    length = command
    if winch.drum_radius > ZERO:
        angle = drum_angle(winch.believed_radius, winch.believed_buildup, command)
        length = paid_out(winch.drum_radius, winch.drum_buildup, angle)
    return length


@wp.func
def read_length(winch: Winch, length: wp.float64) -> wp.float64:
    """Return a perfect encoder's reading of a true length [m]; the inverse of `wound_length`."""
    reading = length
    if winch.drum_radius > ZERO:
        angle = drum_angle(winch.drum_radius, winch.drum_buildup, length)
        reading = paid_out(winch.believed_radius, winch.believed_buildup, angle)
    return reading


@wp.func
def lag_after(lag: wp.float64, change: wp.float64, hysteresis: wp.float64) -> wp.float64:
    """Return the lag after a change of the wound length [m] that goes straight on."""
    out = lag
    if hysteresis > ZERO and change != ZERO:
        way = wp.sign(change)
        out = way + (lag - way) * wp.exp(-wp.abs(change) / (f64(2.0) * hysteresis))
    return out


@wp.func
def paid_out_state(
    winch: Winch, state: WinchState, wound: wp.float64, wound_rate: wp.float64
) -> WinchState:
    """Return the state in which the drum has turned for another length [m], with a rate [m/s]."""
    after = state
    after.wound = wound
    after.wound_rate = wound_rate
    after.lag = lag_after(state.lag, wound - state.wound, winch.hysteresis)
    after.length = wound - winch.hysteresis * after.lag
    after.rate = wound_rate
    if winch.hysteresis > ZERO:
        after.rate = f64(0.5) * (wound_rate + after.lag * wp.abs(wound_rate))
    return after


@wp.func
def resting(length: wp.float64) -> WinchState:
    """Return a winch at rest of a true length [m], in the middle of its hysteresis."""
    out = WinchState()
    out.length = length
    out.wound = length
    return out


@wp.func
def winch_advance(
    winch: Winch, state: WinchState, command: wp.float64, duration: wp.float64
) -> WinchState:
    """Follow a constant command [m] for a time [s], in inner steps of at most its `step_max`.

    Args:
        winch: The winch.
        state: Before.
        command: Length asked of the drive, by the drum that it believes in [m].
        duration: [s]; nothing happens in no time.

    Returns:
        The state after it.
    """
    target = wound_length(winch, command)
    length = state.wound
    rate = state.wound_rate
    integral = state.integral
    if duration > ZERO:
        # Rounding of the duration must not change the count.
        count = wp.max(int(wp.ceil(duration / winch.step_max - f64(1.0e-6))), 1)
        h = duration / f64(count)
        # The lag must be resolved: a faster winch than one step reaches its command in one.
        lag = wp.max(winch.lag, h) + winch.derivative_time
        most = winch.acceleration_max * h
        for _k in range(count):
            error = target - length
            wish = (error + winch.integral_rate * integral) / lag
            change = wp.clamp(wish, -winch.speed_max, winch.speed_max) - rate
            if wp.abs(wish) <= winch.speed_max and wp.abs(change) <= most:
                integral += h * error
            rate += wp.clamp(change, -most, most)
            length += h * rate
    after = paid_out_state(winch, state, length, rate)
    after.integral = integral
    return after


@wp.kernel
def advance(
    winches: wp.array2d(dtype=Winch),
    command: wp.array2d(dtype=wp.float64),
    duration: wp.array(dtype=wp.float64),
    states: wp.array2d(dtype=WinchState),
):
    """Advance the winches of B robots, one thread per winch; one row of winches serves them all."""
    b, i = wp.tid()
    winch = winches[wp.min(b, winches.shape[0] - 1), i]
    states[b, i] = winch_advance(winch, states[b, i], command[b, i], duration[0])


@wp.kernel
def lagging(
    wound: wp.array3d(dtype=wp.float64),
    hysteresis: wp.array2d(dtype=wp.float64),
    lags: wp.array2d(dtype=wp.float64),
    length: wp.array3d(dtype=wp.float64),
):
    """Compute true lengths of wound ones in time, (K, B, n), and lags from first to last.

    One thread a cable.
    """
    b, i = wp.tid()
    h = hysteresis[wp.min(b, hysteresis.shape[0] - 1), i]
    lag = lags[b, i]
    length[0, b, i] = wound[0, b, i] - h * lag
    for k in range(1, wound.shape[0]):
        lag = lag_after(lag, wound[k, b, i] - wound[k - 1, b, i], h)
        length[k, b, i] = wound[k, b, i] - h * lag
    lags[b, i] = lag


@wp.kernel
def read(
    winches: wp.array2d(dtype=Winch),
    length: wp.array2d(dtype=wp.float64),
    reading: wp.array2d(dtype=wp.float64),
):
    """Compute readings of perfect encoders of true lengths [m]."""
    b, i = wp.tid()
    reading[b, i] = read_length(winches[wp.min(b, winches.shape[0] - 1), i], length[b, i])
