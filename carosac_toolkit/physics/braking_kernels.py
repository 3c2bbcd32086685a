# mypy: ignore-errors
"""Warp kernels of the controlled stop: how winches brake, and which commands leave room for it.

Commanded lengths at a fixed period h define v = dL/h, a = dv/h and j = da/h of each cable. Float64,
one thread per row of the batch; a row holds all cables of one robot.
"""

import warp as wp

from carosac_toolkit.physics.straight_line_kernels import misfit, solve_positive

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

f64 = wp.float64
vec3 = wp.vec3d
mat33 = wp.mat33d

NEWTON_STEPS = wp.constant(12)  # a step of the winches moves the platform by centimetres at most
NEWTON_TOLERANCE = wp.constant(wp.float64(1.0e-12))  # gradient norm over the longest length [-]
HALVINGS = wp.constant(30)


@wp.struct
class Rules:
    """What all cables share: period [s], limits, and the rounding each of them allows for."""

    period: f64
    jerk_max: f64
    jump_max: f64
    length_slack: f64
    speed_slack: f64
    acceleration_slack: f64
    jerk_slack: f64
    settle_slack: f64
    steps_max: int
    use_box: int
    box_min: vec3
    box_max: vec3
    box_slack: f64


@wp.func
def brake_step(speed: f64, acceleration: f64, a_max: f64, rules: Rules):
    """Speed and acceleration after one more period of the controlled stop.

    The acceleration sought is the one from which steps of J = jerk_max * period down to zero use
    up the speed exactly: |v| / h = (q + 1) x - J q (q + 1) / 2 with q = floor(x / J). Where it is
    out of reach the nearest end of what jerk and acceleration allow is taken.
    """
    h = rules.period
    jump = rules.jerk_max * h
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
def landing(gap: f64, speed: f64, acceleration: f64, a_max: f64, rules: Rules):
    """The gap [m] at which the controlled stop ends that starts at this gap."""
    v = speed
    a = acceleration
    e = gap
    count = wp.int32(0)
    while (v != f64(0.0) or a != f64(0.0)) and count < rules.steps_max:
        v, a = brake_step(v, a, a_max, rules)
        e += rules.period * v
        count += 1
    return e


@wp.func
def track_position(
    b: int,
    start: vec3,
    turn: mat33,
    exit_point: wp.array(dtype=vec3),
    anchor: wp.array(dtype=vec3),
    radius: wp.array(dtype=f64),
    axis: wp.array(dtype=vec3),
    length: wp.array2d(dtype=f64),
):
    """Straight-line position of row b by plain Newton from a near start; the flag is 1 if found."""
    scale = f64(1.0)
    for i in range(exit_point.shape[0]):
        scale = wp.max(scale, wp.abs(length[b, i]))
    p = start
    found = wp.int32(0)
    count = wp.int32(0)
    while found == 0 and count < NEWTON_STEPS:
        count += 1
        _cost, gradient, hessian, valid = misfit(
            b, p, turn, exit_point, anchor, radius, axis, length
        )
        step, positive = solve_positive(hessian, -gradient)
        if positive == 0 or valid == 0:
            count = NEWTON_STEPS
        elif wp.length(gradient) <= NEWTON_TOLERANCE * scale:
            found = wp.int32(1)
        else:
            p = p + step
    return p, found


@wp.func
def outside_box(position: vec3, rules: Rules):
    """Largest distance beyond a face of the workspace box [m]; 0 inside."""
    out = f64(0.0)
    for k in range(3):
        out = wp.max(out, rules.box_min[k] - position[k])
        out = wp.max(out, position[k] - rules.box_max[k])
    return out


@wp.func
def candidate(
    factor: f64, asked: f64, length: f64, speed: f64, acceleration: f64,
    brake_length: f64, brake_speed: f64, brake_acceleration: f64, period: f64,
):  # fmt: skip
    """Length, speed and acceleration between the step of the controlled stop (0) and asked (1)."""
    new_length = brake_length
    new_speed = brake_speed
    new_acceleration = brake_acceleration
    if factor > f64(0.0):
        new_length = asked
        if factor < f64(1.0):
            new_length = brake_length + factor * (asked - brake_length)
        new_speed = (new_length - length) / period
        new_acceleration = (new_speed - speed) / period
    return new_length, new_speed, new_acceleration


@wp.func
def within(
    i: int, length: f64, speed: f64, acceleration: f64,
    length_min: wp.array(dtype=f64), length_max: wp.array(dtype=f64),
    speed_max: wp.array(dtype=f64), a_max: wp.array(dtype=f64), rules: Rules,
):  # fmt: skip
    """1 where the length, speed and acceleration of a cable are within its limits; NaN is not."""
    inside = wp.int32(0)
    if (
        length >= length_min[i] - rules.length_slack
        and length <= length_max[i] + rules.length_slack
        and wp.abs(speed) <= speed_max[i] + rules.speed_slack
        and wp.abs(acceleration) <= a_max[i] + rules.acceleration_slack
    ):
        inside = wp.int32(1)
    return inside


@wp.func
def first_step(
    b: int, factor: f64, settle: int,
    length: wp.array2d(dtype=f64), speed: wp.array2d(dtype=f64),
    acceleration: wp.array2d(dtype=f64), asked: wp.array2d(dtype=f64),
    pace: wp.array2d(dtype=f64), actual: wp.array2d(dtype=f64), use_actual: int,
    length_min: wp.array(dtype=f64), length_max: wp.array(dtype=f64),
    speed_max: wp.array(dtype=f64), a_max: wp.array(dtype=f64), rules: Rules,
    brake: wp.array3d(dtype=f64), walk: wp.array3d(dtype=f64),
):  # fmt: skip
    """1 where the candidate step itself keeps all limits; it is left in `walk`."""
    ok = wp.int32(1)
    for i in range(length_min.shape[0]):
        x, v, a = candidate(
            factor, asked[b, i], length[b, i], speed[b, i], acceleration[b, i],
            brake[b, i, 0], brake[b, i, 1], brake[b, i, 2], rules.period,
        )  # fmt: skip
        walk[b, i, 0] = x
        walk[b, i, 1] = v
        walk[b, i, 2] = a
        ok *= within(i, x, v, a, length_min, length_max, speed_max, a_max, rules)
        jerk = wp.abs(a - acceleration[b, i]) / rules.period
        if not (jerk <= rules.jerk_max + rules.jerk_slack):
            ok = wp.int32(0)
        if use_actual == 1:
            far = wp.abs(x - actual[b, i])
            if far > rules.jump_max and far >= wp.abs(brake[b, i, 0] - actual[b, i]):
                ok = wp.int32(0)
        if ok == 1 and settle == 1:
            end = landing(x - asked[b, i], v - pace[b, i], a, a_max[i], rules)
            if (
                end < wp.min(brake[b, i, 3], f64(0.0)) - rules.settle_slack
                or end > wp.max(brake[b, i, 3], f64(0.0)) + rules.settle_slack
            ):
                ok = wp.int32(0)
    return ok


@wp.func
def can_stop(
    b: int, start: vec3, turn: mat33,
    exit_point: wp.array(dtype=vec3), anchor: wp.array(dtype=vec3),
    radius: wp.array(dtype=f64), axis: wp.array(dtype=vec3),
    length_min: wp.array(dtype=f64), length_max: wp.array(dtype=f64),
    speed_max: wp.array(dtype=f64), a_max: wp.array(dtype=f64), rules: Rules,
    walk: wp.array3d(dtype=f64), walk_length: wp.array2d(dtype=f64),
):  # fmt: skip
    """1 where the controlled stop from the state in `walk` keeps all limits until it is at rest."""
    ok = wp.int32(1)
    moving = wp.int32(1)
    p = start
    count = wp.int32(0)
    while ok == 1 and moving == 1:
        moving = wp.int32(0)
        for i in range(length_min.shape[0]):
            walk_length[b, i] = walk[b, i, 0]
            v = walk[b, i, 1]
            a = walk[b, i, 2]
            ok *= within(i, walk[b, i, 0], v, a, length_min, length_max, speed_max, a_max, rules)
            if v != f64(0.0) or a != f64(0.0):
                moving = wp.int32(1)
                v, a = brake_step(v, a, a_max[i], rules)
                walk[b, i, 0] = walk[b, i, 0] + rules.period * v
                walk[b, i, 1] = v
                walk[b, i, 2] = a
        if rules.use_box == 1 and ok == 1:
            p, found = track_position(b, p, turn, exit_point, anchor, radius, axis, walk_length)
            if found == 0 or not (outside_box(p, rules) <= rules.box_slack):
                ok = wp.int32(0)
        count += 1
        if count > rules.steps_max:
            ok = wp.int32(0)
    return ok


@wp.kernel
def limit_step(
    length: wp.array2d(dtype=f64), speed: wp.array2d(dtype=f64),
    acceleration: wp.array2d(dtype=f64), position: wp.array(dtype=vec3), rotation: mat33,
    asked: wp.array2d(dtype=f64), pace: wp.array2d(dtype=f64),
    actual: wp.array2d(dtype=f64), use_actual: wp.array(dtype=wp.int32),
    exit_point: wp.array(dtype=vec3), anchor: wp.array(dtype=vec3),
    radius: wp.array(dtype=f64), axis: wp.array(dtype=vec3),
    length_min: wp.array(dtype=f64), length_max: wp.array(dtype=f64),
    speed_max: wp.array(dtype=f64), a_max: wp.array(dtype=f64), rules: Rules,
    brake: wp.array3d(dtype=f64), walk: wp.array3d(dtype=f64),
    walk_length: wp.array2d(dtype=f64), sent_position: wp.array(dtype=vec3),
    sent_length: wp.array2d(dtype=f64), sent_speed: wp.array2d(dtype=f64),
    sent_acceleration: wp.array2d(dtype=f64), factor: wp.array(dtype=f64),
):  # fmt: skip
    """Move from the step of the controlled stop towards the asked one as far as it is admissible.

    `brake` holds, per cable, length, speed and acceleration of the next step of the controlled
    stop, and where that stop ends relative to what is asked, as seen by one who moves along with
    it at `pace`. A step that is shortened may not end beyond: a target would be passed at full
    speed, time and again.
    """
    b = wp.tid()
    reach = f64(1.0)
    for i in range(length_min.shape[0]):
        v, a = brake_step(speed[b, i], acceleration[b, i], a_max[i], rules)
        x = length[b, i] + rules.period * v
        brake[b, i, 0] = x
        brake[b, i, 1] = v
        brake[b, i, 2] = a
        brake[b, i, 3] = landing(x - asked[b, i], v - pace[b, i], a, a_max[i], rules)
        span = wp.abs(asked[b, i] - x)
        most = f64(2.0) * rules.jerk_max * rules.period * rules.period * rules.period
        if span > most:
            reach = wp.min(reach, most / span)
    good = f64(0.0)
    bad = f64(1.0)
    tries = wp.int32(0)
    while tries < HALVINGS:
        trial = f64(1.0)
        if tries == 1:
            trial = reach
        if tries > 1:
            trial = f64(0.5) * (good + bad)
        settle = wp.int32(0)
        if tries > 0:
            settle = wp.int32(1)
        ok = first_step(
            b, trial, settle, length, speed, acceleration, asked, pace, actual, use_actual[0],
            length_min, length_max, speed_max, a_max, rules, brake, walk,
        )  # fmt: skip
        if ok == 1:
            ok = can_stop(
                b, position[b], rotation, exit_point, anchor, radius, axis, length_min,
                length_max, speed_max, a_max, rules, walk, walk_length,
            )  # fmt: skip
        if ok == 1:
            good = trial
            if tries <= 1:
                tries = HALVINGS
        else:
            bad = trial
        tries += 1
    factor[b] = good
    for i in range(length_min.shape[0]):
        x, v, a = candidate(
            good, asked[b, i], length[b, i], speed[b, i], acceleration[b, i],
            brake[b, i, 0], brake[b, i, 1], brake[b, i, 2], rules.period,
        )  # fmt: skip
        sent_length[b, i] = x
        sent_speed[b, i] = v
        sent_acceleration[b, i] = a
    sent_position[b] = position[b]
    if rules.use_box == 1:
        p, found = track_position(
            b, position[b], rotation, exit_point, anchor, radius, axis, sent_length
        )
        if found == 1:
            sent_position[b] = p


@wp.kernel
def brake_all(
    length: wp.array2d(dtype=f64), speed: wp.array2d(dtype=f64),
    acceleration: wp.array2d(dtype=f64), position: wp.array(dtype=vec3), rotation: mat33,
    exit_point: wp.array(dtype=vec3), anchor: wp.array(dtype=vec3),
    radius: wp.array(dtype=f64), axis: wp.array(dtype=vec3),
    a_max: wp.array(dtype=f64), rules: Rules,
    sent_position: wp.array(dtype=vec3),
    sent_length: wp.array2d(dtype=f64), sent_speed: wp.array2d(dtype=f64),
    sent_acceleration: wp.array2d(dtype=f64),
):  # fmt: skip
    """The next step of the controlled stop of every row."""
    b = wp.tid()
    for i in range(a_max.shape[0]):
        v, a = brake_step(speed[b, i], acceleration[b, i], a_max[i], rules)
        sent_length[b, i] = length[b, i] + rules.period * v
        sent_speed[b, i] = v
        sent_acceleration[b, i] = a
    sent_position[b] = position[b]
    if rules.use_box == 1:
        p, found = track_position(
            b, position[b], rotation, exit_point, anchor, radius, axis, sent_length
        )
        if found == 1:
            sent_position[b] = p


@wp.kernel
def look_ahead(
    first: wp.array3d(dtype=f64), position: wp.array(dtype=vec3), rotation: mat33,
    exit_point: wp.array(dtype=vec3), anchor: wp.array(dtype=vec3),
    radius: wp.array(dtype=f64), axis: wp.array(dtype=vec3),
    speed_max: wp.array(dtype=f64), a_max: wp.array(dtype=f64), rules: Rules,
    walk: wp.array3d(dtype=f64), walk_length: wp.array2d(dtype=f64),
    low: wp.array2d(dtype=f64), high: wp.array2d(dtype=f64), peak: wp.array2d(dtype=f64),
    outside: wp.array(dtype=f64),
):  # fmt: skip
    """Extremes of length [m], speed [m/s] and distance outside the box [m] until rest.

    `first` holds length, speed and acceleration per cable. A row in which a cable exceeds its
    speed or acceleration at the first step is looked at there only.
    """
    b = wp.tid()
    moving = wp.int32(1)
    for i in range(a_max.shape[0]):
        for k in range(3):
            walk[b, i, k] = first[b, i, k]
        low[b, i] = first[b, i, 0]
        high[b, i] = first[b, i, 0]
        peak[b, i] = wp.abs(first[b, i, 1])
        slow = wp.abs(first[b, i, 1]) <= speed_max[i] + rules.speed_slack
        if not (slow and wp.abs(first[b, i, 2]) <= a_max[i] + rules.acceleration_slack):
            moving = wp.int32(0)
    whole = moving
    p = position[b]
    outside[b] = f64(0.0)
    count = wp.int32(0)
    again = wp.int32(1)
    while again == 1:
        again = wp.int32(0)
        for i in range(a_max.shape[0]):
            x = walk[b, i, 0]
            v = walk[b, i, 1]
            a = walk[b, i, 2]
            walk_length[b, i] = x
            low[b, i] = wp.min(low[b, i], x)
            high[b, i] = wp.max(high[b, i], x)
            peak[b, i] = wp.max(peak[b, i], wp.abs(v))
            if whole == 1 and count < rules.steps_max and (v != f64(0.0) or a != f64(0.0)):
                again = wp.int32(1)
                v, a = brake_step(v, a, a_max[i], rules)
                walk[b, i, 0] = x + rules.period * v
                walk[b, i, 1] = v
                walk[b, i, 2] = a
        if rules.use_box == 1:
            p, found = track_position(b, p, rotation, exit_point, anchor, radius, axis, walk_length)
            if found == 1:
                outside[b] = wp.max(outside[b], outside_box(p, rules))
            elif whole == 1:
                outside[b] = f64(wp.inf)
                again = wp.int32(0)
        count += 1
