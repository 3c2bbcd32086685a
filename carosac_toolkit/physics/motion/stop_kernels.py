"""Warp functions of the controlled stop: how winches brake, and whether there is room for it.

Commanded lengths at a fixed period h define v = dL/h, a = dv/h and j = da/h of each cable. Float64,
one thread per row of the batch; a row holds all cables of one robot.
"""

import warp as wp

from carosac_toolkit.physics.cable.straight_line_kernels import misfit, solve_positive

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

f64 = wp.float64
vec3 = wp.vec3d

NEWTON_STEPS = wp.constant(12)  # a step of the winches moves the platform by centimetres at most
NEWTON_TOLERANCE = wp.constant(wp.float64(1.0e-12))  # gradient norm over the longest length [-]


@wp.struct
class Rules:
    """Limits and geometry: arrays per cable (n,), and values for all cables.

    The slacks are what rounding leaves uncertain in each quantity.
    """

    period: f64
    jerk_max: f64
    jump_max: f64
    length_slack: f64
    speed_slack: f64
    acceleration_slack: f64
    jerk_slack: f64
    settle_slack: f64
    box_slack: f64
    steps_max: int
    use_box: int
    box_min: vec3
    box_max: vec3
    rotation: wp.mat33d
    exit_points: wp.array(dtype=vec3)
    anchor_points: wp.array(dtype=vec3)
    pulley_radius: wp.array(dtype=f64)
    swivel_axis: wp.array(dtype=vec3)
    length_min: wp.array(dtype=f64)
    length_max: wp.array(dtype=f64)
    speed_max: wp.array(dtype=f64)
    acceleration_max: wp.array(dtype=f64)


@wp.struct
class StopWork:
    """Arrays of a batch: (B, n), positions (B,).

    The motion now; what is asked, its speed and acceleration, and what was measured; the length
    after the next step of the controlled stop; the motion from which a line leads to the asked
    step, with the share of the limits it uses and where it ends relative to what is asked; the
    motion that a look ahead has come to; what is sent; and the extremes of a look ahead.
    """

    length: wp.array2d(dtype=f64)
    speed: wp.array2d(dtype=f64)
    acceleration: wp.array2d(dtype=f64)
    position: wp.array(dtype=vec3)
    asked: wp.array2d(dtype=f64)
    pace: wp.array2d(dtype=f64)
    pace_change: wp.array2d(dtype=f64)
    actual: wp.array2d(dtype=f64)
    use_actual: wp.array(dtype=wp.int32)
    brake_length: wp.array2d(dtype=f64)
    base_length: wp.array2d(dtype=f64)
    base_speed: wp.array2d(dtype=f64)
    base_acceleration: wp.array2d(dtype=f64)
    share: wp.array2d(dtype=f64)
    base_end: wp.array2d(dtype=f64)
    walk_length: wp.array2d(dtype=f64)
    walk_speed: wp.array2d(dtype=f64)
    walk_acceleration: wp.array2d(dtype=f64)
    sent_length: wp.array2d(dtype=f64)
    sent_speed: wp.array2d(dtype=f64)
    sent_acceleration: wp.array2d(dtype=f64)
    sent_position: wp.array(dtype=vec3)
    low: wp.array2d(dtype=f64)
    high: wp.array2d(dtype=f64)
    peak: wp.array2d(dtype=f64)
    outside: wp.array(dtype=f64)


@wp.func
def brake_step(speed: f64, acceleration: f64, a_max: f64, jump: f64, h: f64):
    """Return speed and acceleration after one more period of the controlled stop.

    The acceleration sought is the one from which steps of `jump` = jerk * h down to zero use up
    the speed exactly: |v| / h = (q + 1) x - jump q (q + 1) / 2 with q = floor(x / jump). Where it
    is out of reach the nearest end of what jerk and acceleration allow is taken.
    """
    w = wp.abs(speed) / h
    q = wp.floor((wp.sqrt(f64(1.0) + f64(8.0) * w / jump) - f64(1.0)) * f64(0.5))
    wanted = (w + f64(0.5) * jump * q * (q + f64(1.0))) / (q + f64(1.0))
    if speed > f64(0.0):
        wanted = -wanted
    low = wp.max(acceleration - jump, -a_max)
    high = wp.min(acceleration + jump, a_max)
    chosen = wp.min(wp.max(wanted, low), high)
    left = speed + h * chosen
    if q == f64(0.0) and chosen == wanted:
        left = f64(0.0)  # exactly at rest, no residue of rounding
    return left, chosen


@wp.func
def landing(gap: f64, speed: f64, acceleration: f64, a_max: f64, jump: f64, rules: Rules):
    """Return the gap [m] at which the controlled stop ends that starts at this gap."""
    v = speed
    a = acceleration
    e = gap
    count = wp.int32(0)
    while (v != f64(0.0) or a != f64(0.0)) and count < rules.steps_max:
        v, a = brake_step(v, a, a_max, jump, rules.period)
        e += rules.period * v
        count += 1
    return e


@wp.func
def track_position(b: int, start: vec3, rules: Rules, length: wp.array2d(dtype=f64)):
    """Solve for the straight-line position of row b from a near start; the flag is 1 if found."""
    scale = f64(1.0)
    for i in range(rules.length_min.shape[0]):
        scale = wp.max(scale, wp.abs(length[b, i]))
    p = start
    converged = wp.int32(0)
    count = wp.int32(0)
    while converged == 0 and count < NEWTON_STEPS:
        count += 1
        _cost, gradient, hessian, valid = misfit(
            b, p, rules.rotation, rules.exit_points, rules.anchor_points, rules.pulley_radius,
            rules.swivel_axis, length,
        )  # fmt: skip
        step, positive = solve_positive(hessian, -gradient)
        if positive == 0 or valid == 0:
            count = NEWTON_STEPS
        elif wp.length(gradient) <= NEWTON_TOLERANCE * scale:
            converged = wp.int32(1)
        else:
            p = p + step
    return p, converged


@wp.func
def outside_box(position: vec3, rules: Rules):
    """Return the largest distance beyond a face of the workspace box [m]; 0 inside."""
    out = f64(0.0)
    for k in range(3):
        out = wp.max(out, rules.box_min[k] - position[k])
        out = wp.max(out, position[k] - rules.box_max[k])
    return out


@wp.func
def within(i: int, length: f64, speed: f64, acceleration: f64, rules: Rules):
    """Return 1 if length, speed and acceleration of a cable are within limits; NaN is not."""
    inside = wp.int32(0)
    if (
        length >= rules.length_min[i] - rules.length_slack
        and length <= rules.length_max[i] + rules.length_slack
        and wp.abs(speed) <= rules.speed_max[i] + rules.speed_slack
        and wp.abs(acceleration) <= rules.acceleration_max[i] + rules.acceleration_slack
    ):
        inside = wp.int32(1)
    return inside


@wp.func
def can_stop(b: int, work: StopWork, rules: Rules):
    """Return 1 if the controlled stop from the walk's motion keeps all limits until rest."""
    ok = wp.int32(1)
    moving = wp.int32(1)
    p = work.position[b]
    jump = rules.jerk_max * rules.period
    count = wp.int32(0)
    while ok == 1 and moving == 1:
        if rules.use_box == 1:
            p, tracked = track_position(b, p, rules, work.walk_length)
            if tracked == 0 or not (outside_box(p, rules) <= rules.box_slack):
                ok = wp.int32(0)
        moving = wp.int32(0)
        for i in range(rules.length_min.shape[0]):
            v = work.walk_speed[b, i]
            a = work.walk_acceleration[b, i]
            if v != f64(0.0) or a != f64(0.0):
                moving = wp.int32(1)
                v, a = brake_step(v, a, rules.acceleration_max[i], jump, rules.period)
                x = work.walk_length[b, i] + rules.period * v
                work.walk_length[b, i] = x
                work.walk_speed[b, i] = v
                work.walk_acceleration[b, i] = a
                ok *= within(i, x, v, a, rules)
        count += 1
        if count > rules.steps_max:
            ok = wp.int32(0)
    return ok
