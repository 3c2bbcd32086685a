"""Warp kernels that keep commands where the controlled stop has room; see `stop_kernels`."""

import warp as wp

from carosac_toolkit.physics.motion.stop_kernels import (
    Rules,
    StopWork,
    brake_step,
    can_stop,
    landing,
    outside_box,
    track_position,
    within,
)

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

f64 = wp.float64

BISECTION_STEPS = wp.constant(20)  # to a millionth of what jerk allows in one period
LIMIT_SHARE_MIN = wp.constant(wp.float64(1.0e-3))


@wp.func
def candidate(b: int, i: int, factor: f64, work: StopWork, h: f64):
    """Return length, speed and acceleration between the base (0) and the asked step (1)."""
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
def base_on_brake(b: int, work: StopWork, rules: Rules):
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
    """Return the ratio of a part to its whole, 0 for a whole of zero."""
    share = f64(0.0)
    if whole > f64(0.0):
        share = wp.abs(part) / whole
    return share


@wp.func
def base_in_step(b: int, work: StopWork, rules: Rules):
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
        share = wp.max(share, LIMIT_SHARE_MIN)
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
def first_step(b: int, factor: f64, settle: int, work: StopWork, rules: Rules):
    """Return 1 if the candidate step itself keeps all limits; it is left in the walk.

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
def admissible(b: int, factor: f64, settle: int, work: StopWork, rules: Rules):
    """Return 1 if the candidate keeps all limits and leaves room for the controlled stop."""
    ok = first_step(b, factor, settle, work, rules)
    if ok == 1:
        ok = can_stop(b, work, rules)
    return ok


@wp.func
def can_follow(b: int, work: StopWork, rules: Rules):
    """Return 1 if cables that take the asked step can follow what is asked from then on.

    Cables that already follow can. Others arrive with an excess of speed. The next step has to
    remove it, and the one after that has to change to the acceleration of what is asked, both
    within the limits. Otherwise cables would pass the target, turn back, and pass it again.
    """
    ok = wp.int32(1)
    h = rules.period
    jump = h * (rules.jerk_max + rules.jerk_slack)
    for i in range(rules.length_min.shape[0]):
        v = (work.asked[b, i] - work.length[b, i]) / h
        a = (v - work.speed[b, i]) / h
        excess = (v - work.pace[b, i]) / h
        a_next = work.pace_change[b, i] - excess
        if excess != f64(0.0) and (
            wp.abs(excess) > jump
            or wp.abs(a_next - a) > jump
            or wp.abs(a_next) > rules.acceleration_max[i] + rules.acceleration_slack
        ):
            ok = wp.int32(0)
    return ok


@wp.func
def search(b: int, good: f64, work: StopWork, rules: Rules):
    """Find the farthest admissible candidate towards the asked step; `good` is one, or < 0."""
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
        for _k in range(BISECTION_STEPS):
            trial = f64(0.5) * (best + bad)
            if admissible(b, trial, 1, work, rules) == 1:
                best = trial
            else:
                bad = trial
    return best


@wp.func
def send(b: int, factor: f64, work: StopWork, rules: Rules):
    """Write the candidate out."""
    for i in range(rules.length_min.shape[0]):
        x, v, a = candidate(b, i, factor, work, rules.period)
        work.sent_length[b, i] = x
        work.sent_speed[b, i] = v
        work.sent_acceleration[b, i] = a
    work.sent_position[b] = work.position[b]
    if rules.use_box == 1:
        p, tracked = track_position(b, work.position[b], rules, work.sent_length)
        if tracked == 1:
            work.sent_position[b] = p


@wp.kernel
def limit_step(work: StopWork, rules: Rules):
    """Send the asked step if it is admissible and can be kept, else one as far towards it as is.

    Two lines lead there: from a step in which the cables match its pace together, and where that
    is not admissible, from the next step of the controlled stop, which always is.
    """
    b = wp.tid()
    base_on_brake(b, work, rules)
    factor = f64(1.0)
    if can_follow(b, work, rules) == 0 or admissible(b, factor, 0, work, rules) == 0:
        base_in_step(b, work, rules)
        factor = search(b, f64(-1.0), work, rules)
        if factor < f64(0.0):
            base_on_brake(b, work, rules)
            factor = search(b, f64(0.0), work, rules)
    send(b, factor, work, rules)


@wp.kernel
def brake_all(work: StopWork, rules: Rules):
    """Send the next step of the controlled stop."""
    b = wp.tid()
    base_on_brake(b, work, rules)
    send(b, f64(0.0), work, rules)


@wp.func
def note_extremes(b: int, work: StopWork, rules: Rules):
    """Widen the extremes by what the walk has come to."""
    for i in range(rules.length_min.shape[0]):
        work.low[b, i] = wp.min(work.low[b, i], work.walk_length[b, i])
        work.high[b, i] = wp.max(work.high[b, i], work.walk_length[b, i])
        work.peak[b, i] = wp.max(work.peak[b, i], wp.abs(work.walk_speed[b, i]))


@wp.kernel
def look_ahead(work: StopWork, rules: Rules):
    """Compute extremes of length [m], speed [m/s] and distance outside the box [m] until rest.

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
            p, tracked = track_position(b, p, rules, work.walk_length)
            if tracked == 1:
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
