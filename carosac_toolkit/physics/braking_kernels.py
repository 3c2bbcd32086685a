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

NEWTON_STEPS = wp.constant(12)  # a step of the winches moves the platform by centimetres at most
NEWTON_TOLERANCE = wp.constant(wp.float64(1.0e-12))  # gradient norm over the longest length [-]
HALVINGS = wp.constant(20)  # to a millionth of what jerk allows in one period
SMALLEST_SHARE = wp.constant(wp.float64(1.0e-3))


@wp.struct
class Rules:
    """Limits and geometry: arrays per cable (n,), and what all cables share.

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
class Work:
    """Arrays of a batch: (B, n), positions (B,).

    The motion now; what is asked, how fast that moves and what was measured; the length after the
    next step of the controlled stop; the motion from which a line leads to the asked step, with
    the share of the limits it uses and where it ends relative to what is asked; the motion that a
    look ahead has come to; what is sent; and the extremes of a look ahead.
    """

    length: wp.array2d(dtype=f64)
    speed: wp.array2d(dtype=f64)
    acceleration: wp.array2d(dtype=f64)
    position: wp.array(dtype=vec3)
    asked: wp.array2d(dtype=f64)
    pace: wp.array2d(dtype=f64)
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
    """Speed and acceleration after one more period of the controlled stop.

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
    """The gap [m] at which the controlled stop ends that starts at this gap."""
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
    """Straight-line position of row b by plain Newton from a near start; the flag is 1 if found."""
    scale = f64(1.0)
    for i in range(rules.length_min.shape[0]):
        scale = wp.max(scale, wp.abs(length[b, i]))
    p = start
    found = wp.int32(0)
    count = wp.int32(0)
    while found == 0 and count < NEWTON_STEPS:
        count += 1
        _cost, gradient, hessian, valid = misfit(
            b, p, rules.rotation, rules.exit_points, rules.anchor_points, rules.pulley_radius,
            rules.swivel_axis, length,
        )  # fmt: skip
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
def within(i: int, length: f64, speed: f64, acceleration: f64, rules: Rules):
    """1 where the length, speed and acceleration of a cable are within its limits; NaN is not."""
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
def candidate(b: int, i: int, factor: f64, work: Work, h: f64):
    """Length, speed and acceleration on the line from the base (0) to the asked step (1)."""
    x = work.base_length[b, i]
    v = work.base_speed[b, i]
    a = work.base_acceleration[b, i]
    if factor > f64(0.0):
        if factor < f64(1.0):
            x += factor * (work.asked[b, i] - x)
        else:
            x = work.asked[b, i]
        v = (x - work.length[b, i]) / h
        a = (v - work.speed[b, i]) / h
    return x, v, a


@wp.func
def base_on_brake(b: int, work: Work, rules: Rules):
    """Take the next step of the controlled stop of each cable as the base."""
    for i in range(rules.length_min.shape[0]):
        jump = rules.jerk_max * rules.period
        a_max = rules.acceleration_max[i]
        v, a = brake_step(work.speed[b, i], work.acceleration[b, i], a_max, jump, rules.period)
        x = work.length[b, i] + rules.period * v
        work.brake_length[b, i] = x
        work.base_length[b, i] = x
        work.base_speed[b, i] = v
        work.base_acceleration[b, i] = a
        work.share[b, i] = f64(1.0)
        gap = x - work.asked[b, i]
        work.base_end[b, i] = landing(gap, v - work.pace[b, i], a, a_max, jump, rules)


@wp.func
def ratio(part: f64, whole: f64):
    """Part of a whole, 0 of nothing."""
    share = f64(0.0)
    if whole > f64(0.0):
        share = wp.abs(part) / whole
    return share


@wp.func
def base_in_step(b: int, work: Work, rules: Rules):
    """Take as the base a step in which the cables match the pace of what is asked together.

    Each cable brakes, relative to that pace, with its share of jerk and acceleration: that of its
    gap, relative speed or acceleration in the largest of all cables. Cables whose motions are in
    proportion stay in proportion.
    """
    n = rules.length_min.shape[0]
    gap_max = f64(0.0)
    speed_max = f64(0.0)
    a_most = f64(0.0)
    a_least = rules.acceleration_max[0]
    for i in range(n):
        gap_max = wp.max(gap_max, wp.abs(work.asked[b, i] - work.length[b, i]))
        speed_max = wp.max(speed_max, wp.abs(work.speed[b, i] - work.pace[b, i]))
        a_most = wp.max(a_most, wp.abs(work.acceleration[b, i]))
        a_least = wp.min(a_least, rules.acceleration_max[i])
    for i in range(n):
        share = ratio(work.asked[b, i] - work.length[b, i], gap_max)
        share = wp.max(share, ratio(work.speed[b, i] - work.pace[b, i], speed_max))
        share = wp.max(share, ratio(work.acceleration[b, i], a_most))
        share = wp.max(share, SMALLEST_SHARE)
        a_max = share * a_least
        jump = share * rules.jerk_max * rules.period
        v, a = brake_step(
            work.speed[b, i] - work.pace[b, i], work.acceleration[b, i], a_max, jump, rules.period
        )
        v += work.pace[b, i]
        x = work.length[b, i] + rules.period * v
        work.base_length[b, i] = x
        work.base_speed[b, i] = v
        work.base_acceleration[b, i] = a
        if work.pace[b, i] != f64(0.0):  # rounding: derive them from the length like any other
            work.base_acceleration[b, i] = (v - work.speed[b, i]) / rules.period
        work.share[b, i] = share * a_least / rules.acceleration_max[i]
        gap = x - work.asked[b, i]
        work.base_end[b, i] = landing(gap, v - work.pace[b, i], a, a_max, jump, rules)


@wp.func
def first_step(b: int, factor: f64, settle: int, work: Work, rules: Rules):
    """1 where the candidate step itself keeps all limits; it is left in the walk.

    With `settle`, 1 also needs that it does not end beyond what is asked, seen by one who moves
    along at its pace: a target would be passed at full speed, time and again.
    """
    ok = wp.int32(1)
    for i in range(rules.length_min.shape[0]):
        x, v, a = candidate(b, i, factor, work, rules.period)
        work.walk_length[b, i] = x
        work.walk_speed[b, i] = v
        work.walk_acceleration[b, i] = a
        ok *= within(i, x, v, a, rules)
        jerk = wp.abs(a - work.acceleration[b, i]) / rules.period
        if not (jerk <= rules.jerk_max + rules.jerk_slack):
            ok = wp.int32(0)
        if work.use_actual[0] == 1:
            far = wp.abs(x - work.actual[b, i])
            if far > rules.jump_max and far >= wp.abs(work.brake_length[b, i] - work.actual[b, i]):
                ok = wp.int32(0)
        if ok == 1 and settle == 1:
            share = work.share[b, i]
            end = landing(
                x - work.asked[b, i], v - work.pace[b, i], a,
                share * rules.acceleration_max[i], share * rules.jerk_max * rules.period, rules,
            )  # fmt: skip
            base = work.base_end[b, i]
            if (
                end < wp.min(base, f64(0.0)) - rules.settle_slack
                or end > wp.max(base, f64(0.0)) + rules.settle_slack
            ):
                ok = wp.int32(0)
    return ok


@wp.func
def can_stop(b: int, work: Work, rules: Rules):
    """1 where the controlled stop from the walk's motion keeps all limits until it is at rest."""
    ok = wp.int32(1)
    moving = wp.int32(1)
    p = work.position[b]
    jump = rules.jerk_max * rules.period
    count = wp.int32(0)
    while ok == 1 and moving == 1:
        if rules.use_box == 1:
            p, found = track_position(b, p, rules, work.walk_length)
            if found == 0 or not (outside_box(p, rules) <= rules.box_slack):
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


@wp.func
def admissible(b: int, factor: f64, settle: int, work: Work, rules: Rules):
    """1 where the candidate keeps all limits and leaves room for the controlled stop."""
    ok = first_step(b, factor, settle, work, rules)
    if ok == 1:
        ok = can_stop(b, work, rules)
    return ok


@wp.func
def search(b: int, good: f64, work: Work, rules: Rules):
    """The farthest admissible candidate towards the asked step; `good` is one, or negative."""
    best = good
    reach = f64(1.0)
    most = f64(2.0) * rules.jerk_max * rules.period * rules.period * rules.period
    for i in range(rules.length_min.shape[0]):
        span = wp.abs(work.asked[b, i] - work.base_length[b, i])
        if span > most:
            reach = wp.min(reach, most / span)
    if best < f64(0.0) and admissible(b, f64(0.0), 0, work, rules) == 1:
        best = f64(0.0)
    if best >= f64(0.0):
        bad = reach
        for _k in range(HALVINGS):
            trial = f64(0.5) * (best + bad)
            if admissible(b, trial, 1, work, rules) == 1:
                best = trial
            else:
                bad = trial
    return best


@wp.func
def send(b: int, factor: f64, work: Work, rules: Rules):
    """Write the candidate out."""
    for i in range(rules.length_min.shape[0]):
        x, v, a = candidate(b, i, factor, work, rules.period)
        work.sent_length[b, i] = x
        work.sent_speed[b, i] = v
        work.sent_acceleration[b, i] = a
    work.sent_position[b] = work.position[b]
    if rules.use_box == 1:
        p, found = track_position(b, work.position[b], rules, work.sent_length)
        if found == 1:
            work.sent_position[b] = p


@wp.kernel
def limit_step(work: Work, rules: Rules):
    """Send the asked step if it is admissible, else one as far towards it as is.

    Two lines lead there: from a step in which the cables match its pace together, and where that
    is not admissible, from the next step of the controlled stop, which always is.
    """
    b = wp.tid()
    base_on_brake(b, work, rules)
    factor = f64(1.0)
    if admissible(b, factor, 0, work, rules) == 0:
        base_in_step(b, work, rules)
        factor = search(b, f64(-1.0), work, rules)
        if factor < f64(0.0):
            base_on_brake(b, work, rules)
            factor = search(b, f64(0.0), work, rules)
    send(b, factor, work, rules)


@wp.kernel
def brake_all(work: Work, rules: Rules):
    """Send the next step of the controlled stop."""
    b = wp.tid()
    base_on_brake(b, work, rules)
    send(b, f64(0.0), work, rules)


@wp.func
def note_extremes(b: int, work: Work, rules: Rules):
    """Widen the extremes by what the walk has come to."""
    for i in range(rules.length_min.shape[0]):
        work.low[b, i] = wp.min(work.low[b, i], work.walk_length[b, i])
        work.high[b, i] = wp.max(work.high[b, i], work.walk_length[b, i])
        work.peak[b, i] = wp.max(work.peak[b, i], wp.abs(work.walk_speed[b, i]))


@wp.kernel
def look_ahead(work: Work, rules: Rules):
    """Extremes of length [m], speed [m/s] and distance outside the box [m] until rest.

    It starts from the motion now. A row in which a cable exceeds its speed or acceleration is
    looked at there only.
    """
    b = wp.tid()
    whole = wp.int32(1)
    for i in range(rules.length_min.shape[0]):
        v = work.speed[b, i]
        a = work.acceleration[b, i]
        work.walk_length[b, i] = work.length[b, i]
        work.walk_speed[b, i] = v
        work.walk_acceleration[b, i] = a
        work.low[b, i] = work.length[b, i]
        work.high[b, i] = work.length[b, i]
        work.peak[b, i] = wp.abs(v)
        whole *= within(i, rules.length_min[i], v, a, rules)
    p = work.position[b]
    out = f64(0.0)
    count = wp.int32(0)
    again = wp.int32(1)
    while again == 1:
        again = wp.int32(0)
        note_extremes(b, work, rules)
        if rules.use_box == 1:
            p, found = track_position(b, p, rules, work.walk_length)
            if found == 1:
                out = wp.max(out, outside_box(p, rules))
            elif whole == 1:
                out = f64(wp.inf)
        if whole == 1 and count < rules.steps_max and out < f64(wp.inf):
            for i in range(rules.length_min.shape[0]):
                v = work.walk_speed[b, i]
                a = work.walk_acceleration[b, i]
                if v != f64(0.0) or a != f64(0.0):
                    again = wp.int32(1)
                    v, a = brake_step(
                        v, a, rules.acceleration_max[i], rules.jerk_max * rules.period,
                        rules.period,
                    )  # fmt: skip
                    work.walk_length[b, i] = work.walk_length[b, i] + rules.period * v
                    work.walk_speed[b, i] = v
                    work.walk_acceleration[b, i] = a
        count += 1
    work.outside[b] = out
