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
    length = state.length
    rate = state.rate
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
    after = WinchState()
    after.length = length
    after.rate = rate
    after.integral = integral
    return after


@wp.kernel
def advance(
    winches: wp.array2d(dtype=Winch),
    command: wp.array2d(dtype=wp.float64),
    duration: wp.array(dtype=wp.float64),
    length: wp.array2d(dtype=wp.float64),
    rate: wp.array2d(dtype=wp.float64),
    integral: wp.array2d(dtype=wp.float64),
):
    """Advance the winches of B robots, one thread per winch; one row of winches serves them all."""
    b, i = wp.tid()
    winch = winches[wp.min(b, winches.shape[0] - 1), i]
    state = WinchState()
    state.length = length[b, i]
    state.rate = rate[b, i]
    state.integral = integral[b, i]
    state = winch_advance(winch, state, command[b, i], duration[0])
    length[b, i] = state.length
    rate[b, i] = state.rate
    integral[b, i] = state.integral


@wp.kernel
def read(
    winches: wp.array2d(dtype=Winch),
    length: wp.array2d(dtype=wp.float64),
    reading: wp.array2d(dtype=wp.float64),
):
    """Compute readings of perfect encoders of true lengths [m]."""
    b, i = wp.tid()
    reading[b, i] = read_length(winches[wp.min(b, winches.shape[0] - 1), i], length[b, i])
