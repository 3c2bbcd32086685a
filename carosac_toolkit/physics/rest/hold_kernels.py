"""Rest with the largest margin: sagging cables hold a position, all tensions far from their limits.

Sequential linear programming. At given rotation and tensions the cables are linearised (columns
d wrench / d tension, stiffness at constant tension) and `margin_kernels.largest_margin` says where
to go; with fewer than six cables the rotation is an unknown too, within a trust region that shrinks
where the balance got worse or the margin smaller than promised. Cables know no tensions beyond
their limits here: there they are continued to first order, which leaves the sign of a margin exact.
"""

import warp as wp

from carosac_toolkit.physics.cable.catenary_kernels import DIVISION_FLOOR, ONE, TWO, ZERO, vec6d
from carosac_toolkit.physics.cable.tension_kernels import LEAST_TENSION_FACTOR, Pulling, pull
from carosac_toolkit.physics.device_kernels import Cable, StaticBody, anchor_of
from carosac_toolkit.physics.rest.inverse_kernels import (
    first_tensions,
    judge_pose,
    scaled_force,
    scaled_wrench,
    set_limits,
)
from carosac_toolkit.physics.rest.margin_kernels import (
    MARGIN_SOLVED,
    MARGIN_UNSOLVED,
    MarginWork,
    largest_margin,
    nearest_balance,
)
from carosac_toolkit.physics.rest.platform_kernels import (
    Poses,
    lever_terms,
    orthonormal,
    rotation_of,
)
from carosac_toolkit.physics.rest.start_kernels import (
    POSITION_FIT_ROUNDS,
    START_TILT_RAD,
    fit_straight,
)

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

HOLD_STEPS_MAX = wp.constant(40)
HOLD_ATTEMPTS = wp.constant(5)  # rotations to start from: home, then tilted ones if none was solved
RANK_STABLE = wp.constant(2)  # best rank of an answer; 1: solved, 0: not solved
TRUST_RADIUS_RAD = wp.constant(wp.float64(0.3))  # [rad] first trust region
HOLD_RESIDUAL_PER_WEIGHT = wp.constant(wp.float64(1.0e-11))  # wrench left, of the weight
MARGIN_GAIN_PER_WEIGHT = wp.constant(wp.float64(1.0e-9))  # margin still to be gained, of the weight
STEP_PORTION_MIN = wp.constant(wp.float64(1.0e-3))  # part of a step
GAIN_NOISE_PER_WEIGHT = wp.constant(wp.float64(1.0e-10))  # of the weight
WRENCH_PENALTY = wp.constant(wp.float64(1.0))  # N of margin that a N of wrench left costs


@wp.struct
class Turning:
    """Wrench on the platform, and its derivative under rotation at constant tensions."""

    force: wp.vec3d  # [N]
    moment: wp.vec3d  # at the platform origin [N m]
    force_r: wp.mat33d  # d force / d rotation vector [N]
    moment_r: wp.mat33d  # [N m]


@wp.func
def add_turning(total: Turning, arm: wp.vec3d, force: wp.vec3d, k: wp.mat33d) -> Turning:
    """Add a force at a lever arm. k = -d force / d anchor is not symmetric at constant tension."""
    out = Turning()
    moment, kx, xkx, turn = lever_terms(arm, force, k)
    out.force = total.force + force
    out.moment = total.moment + moment
    out.force_r = total.force_r + kx
    out.moment_r = total.moment_r + xkx + turn
    return out


@wp.func
def continued_cables(cables: wp.array2d(dtype=Cable), row: int, b: int, body: StaticBody,
                     p: wp.vec3d, r: wp.mat33d, external: vec6d,
                     poses: Poses) -> vec6d:  # fmt: skip
    """Return the scaled wrench; cables continue to first order beyond their limits.

    Sets the columns: of the tensions, then of the rotation in units of 1 / weight; and by how much
    a cable at most misses its anchor point, where it could not be hung.
    """
    n = poses.tension.shape[1]
    total = Turning()
    missed = wp.float64(0.0)
    weight = wp.vec3d(ZERO, ZERO, -body.weight)
    total = add_turning(total, r * body.center_of_mass, weight, wp.mat33d())
    for i in range(n):
        anchor = anchor_of(cables[row, i], p, r)
        arm = anchor - p
        asked = poses.tension[b, i]
        t = wp.clamp(asked, poses.lower[b, i], poses.upper[b, i])
        g = Pulling()
        g.q = poses.q[b, i]
        g.unstrained_length = poses.unstrained_length[b, i]
        g = pull(g, anchor, t, cables[row, i], wp.float64(1.0e-14), 40)
        poses.q[b, i] = g.q
        poses.unstrained_length[b, i] = g.unstrained_length
        missed = wp.max(missed, wp.length(g.hanging.closure))
        force = g.hanging.force + (asked - t) * g.force_t
        total = add_turning(total, arm, force, (asked / t) * g.stiffness)
        poses.column[b, i] = scaled_force(g.force_t, wp.cross(arm, g.force_t), body.arm)
    poses.closure[b] = missed
    for j in range(poses.column.shape[1] - n):
        force_r = wp.vec3d(total.force_r[0, j], total.force_r[1, j], total.force_r[2, j])
        moment_r = wp.vec3d(total.moment_r[0, j], total.moment_r[1, j], total.moment_r[2, j])
        poses.column[b, n + j] = scaled_force(force_r, moment_r, body.arm) / body.weight
    return scaled_force(total.force, total.moment, body.arm) + scaled_wrench(external, body.arm)


@wp.func
def margin_of(b: int, poses: Poses) -> wp.float64:
    """Return the least distance of the tensions to their limits [N]."""
    out = wp.float64(1.0e300)
    for i in range(poses.tension.shape[1]):
        t = poses.tension[b, i]
        out = wp.min(out, wp.min(t - poses.lower[b, i], poses.upper[b, i] - t))
    return out


@wp.struct
class HoldSearch:
    """End of one search."""

    rotation: wp.mat33d
    status: int
    margin: wp.float64
    gap: wp.float64
    steps: int


@wp.func
def go(b: int, n: int, free: int, start: wp.mat33d, weight: wp.float64, poses: Poses) -> wp.mat33d:
    """Take the step, scaled down if it turns too far; return the rotation after it."""
    turn = wp.vec3d()
    for j in range(free):
        turn[j] = poses.wanted[b, n + j] / weight
    scale = wp.min(ONE, wp.float64(0.5) / (wp.length(turn) + DIVISION_FLOOR))
    for i in range(n):
        t = poses.tension[b, i]
        poses.kept[b, i] = t
        poses.tension[b, i] = t + scale * (poses.wanted[b, i] - t)
    return orthonormal(rotation_of(scale * turn) * start)


@wp.func
def keep_weights(line: int, b: int, n: int, poses: Poses, work: MarginWork):
    """Store the multipliers of the tension limits."""
    for i in range(n):
        poses.low[b, i] = work.weight[line, i]
        poses.high[b, i] = work.weight[line, n + i]


@wp.func
def angle_between(a: wp.mat33d, b: wp.mat33d) -> wp.float64:
    """Return the angle of the rotation from one to the other [rad]."""
    return TWO * wp.asin(wp.min(ONE, wp.sqrt(wp.ddot(a - b, a - b) / wp.float64(8.0))))


@wp.func
def step_back(b: int, n: int, portion: wp.float64, poses: Poses):
    """Take a smaller portion of the step from the tensions before it."""
    for i in range(n):
        t = poses.kept[b, i]
        poses.tension[b, i] = t + portion * (poses.wanted[b, i] - t)


@wp.func
def aim(b: int, wrench: vec6d, poses: Poses) -> vec6d:
    """Return the target for the columns; `wanted` gets the present tensions and no rotation."""
    n = poses.tension.shape[1]
    target = -wrench
    for j in range(poses.column.shape[1]):
        poses.wanted[b, j] = ZERO
    for i in range(n):
        poses.wanted[b, i] = poses.tension[b, i]
        target = target + poses.tension[b, i] * poses.column[b, i]
    return target


@wp.func
def come_to_rest(cables: wp.array2d(dtype=Cable), row: int, b: int, body: StaticBody,
                 external: vec6d, line: int, poses: Poses, work: MarginWork,
                 start: HoldSearch) -> HoldSearch:  # fmt: skip
    """Balance a search that ended early, changing as little as possible.

    Its margin may not be the largest; the gap says what a last step promised. It decides only
    where that cannot change its sign.
    """
    n = poses.tension.shape[1]
    count = poses.column.shape[1]
    out = start
    out.status = MARGIN_UNSOLVED
    balanced = int(1)
    for _step in range(12):
        if balanced == 1 and out.status == MARGIN_UNSOLVED:
            wrench = continued_cables(
                cables, row, b, body, poses.position[b], out.rotation, external, poses
            )  # fmt: skip
            out.steps += 1
            out.margin = margin_of(b, poses)
            decided = out.margin >= ZERO or out.margin + start.gap < ZERO
            if wp.length(wrench) <= HOLD_RESIDUAL_PER_WEIGHT * body.weight and decided:
                out.status = MARGIN_SOLVED
            else:
                target = aim(b, wrench, poses)
                balanced = nearest_balance(poses.column, b, count, target, line, work, poses.wanted)
                out.rotation = go(b, n, count - n, out.rotation, body.weight, poses)
    keep_weights(line, b, n, poses, work)
    return out


@wp.func
def seek(cables: wp.array2d(dtype=Cable), row: int, b: int, body: StaticBody, start: wp.mat33d,
         external: vec6d, line: int, poses: Poses, work: MarginWork) -> HoldSearch:  # fmt: skip
    """Climb to the largest margin from a rotation and the tensions of the pose.

    Margin less penalty times the wrench left is what has to grow. Where a step did not do so, it
    is taken in part; with a free rotation it is found anew in a smaller trust region.
    """
    n = poses.tension.shape[1]
    count = poses.column.shape[1]
    p = poses.position[b]
    out = HoldSearch()
    out.rotation = start
    r = start
    reach = TRUST_RADIUS_RAD
    portion = wp.float64(1.0)
    penalty = WRENCH_PENALTY
    margin = wp.float64(0.0)
    left = wp.float64(0.0)
    promised = wp.float64(0.0)
    going = bool(True)
    while going and out.steps < HOLD_STEPS_MAX:
        wrench = continued_cables(cables, row, b, body, p, r, external, poses)
        out.steps += 1
        gain = margin_of(b, poses) - margin - penalty * (wp.length(wrench) - left)
        poor = (
            out.steps > 1
            and gain < wp.float64(0.05) * promised - GAIN_NOISE_PER_WEIGHT * body.weight
        )
        if poor and count == n and portion > STEP_PORTION_MIN:
            portion = wp.float64(0.25) * portion
            promised = wp.float64(0.25) * promised
            step_back(b, n, portion, poses)
        else:
            if poor and count > n:
                reach = wp.float64(0.25) * wp.min(reach, angle_between(r, out.rotation))
                r = out.rotation
                step_back(b, n, ZERO, poses)
                wrench = continued_cables(cables, row, b, body, p, r, external, poses)
            elif out.steps > 1:
                reach = wp.min(TWO * reach, TRUST_RADIUS_RAD)
            portion = wp.float64(1.0)
            out.rotation = r
            margin = margin_of(b, poses)
            left = wp.length(wrench)
            target = aim(b, wrench, poses)
            best = largest_margin(
                poses.column, b, n, count, target, reach * body.weight, poses.lower, poses.upper,
                line, work, poses.wanted,
            )  # fmt: skip
            penalty = wp.max(penalty, TWO * (margin - best.margin) / (left + DIVISION_FLOOR))
            promised = best.margin - margin + penalty * left
            out.margin = margin
            out.gap = wp.abs(best.margin - margin) + best.gap
            if best.status != MARGIN_SOLVED:
                out.status = best.status
                going = False
            elif (
                left <= HOLD_RESIDUAL_PER_WEIGHT * body.weight
                and out.gap <= MARGIN_GAIN_PER_WEIGHT * body.weight
            ):
                out.status = MARGIN_SOLVED
                keep_weights(line, b, n, poses, work)
                going = False
            else:
                r = go(b, n, count - n, r, body.weight, poses)
    if going:
        step_back(b, n, ZERO, poses)
        out = come_to_rest(cables, row, b, body, external, line, poses, work, out)
    return out


@wp.func
def start_cold(cables: wp.array2d(dtype=Cable), row: int, b: int, body: StaticBody,
               first: wp.mat33d, poses: Poses) -> wp.mat33d:  # fmt: skip
    """Return the rotation of a rest of straight cables near the position; set its tensions."""
    r = first
    n = poses.tension.shape[1]
    if poses.column.shape[1] > n:
        r = fit_straight(cables, row, b, body, poses.position[b], first, poses)
    else:
        for i in range(n):
            poses.tension[b, i] = body.weight
    return r


@wp.func
def limits_moved(cables: wp.array2d(dtype=Cable), row: int, b: int, body: StaticBody, r: wp.mat33d,
                 poses: Poses) -> bool:  # fmt: skip
    """Set the limits anew; whether a heavy cable's lower one has changed with the rotation."""
    most = wp.float64(0.0)
    for i in range(poses.tension.shape[1]):
        poses.kept[b, i] = poses.lower[b, i]
    set_limits(cables, row, b, body, poses.position[b], r, LEAST_TENSION_FACTOR, poses)
    for i in range(poses.tension.shape[1]):
        most = wp.max(most, wp.abs(poses.lower[b, i] - poses.kept[b, i]))
    return most > wp.float64(1.0e-8) * body.weight


@wp.func
def tilted(attempt: int, rotation: wp.mat33d) -> wp.mat33d:
    """Return the rotation itself, then four tilted ones."""
    tilt = wp.vec3d()
    if attempt > 0:
        tilt[attempt % 2] = wp.where(attempt > 2, -START_TILT_RAD, START_TILT_RAD)
    return rotation_of(tilt) * rotation


@wp.func
def judge_rest(cables: wp.array2d(dtype=Cable), row: int, b: int, body: StaticBody, r: wp.mat33d,
               external: vec6d, poses: Poses) -> int:  # fmt: skip
    """Judge a rest by its lengths alone, its tensions kept; 1 where it is stable."""
    for i in range(poses.tension.shape[1]):
        poses.kept[b, i] = poses.tension[b, i]
    stable = judge_pose(cables, row, b, body, r, external, poses)
    for i in range(poses.tension.shape[1]):
        poses.tension[b, i] = poses.kept[b, i]
    return stable


@wp.func
def try_from(cables: wp.array2d(dtype=Cable), row: int, b: int, body: StaticBody, r: wp.mat33d,
             external: vec6d, line: int, poses: Poses, work: MarginWork) -> int:  # fmt: skip
    """Search once, store the answer with the pose and return its rank, RANK_STABLE at best."""
    p = poses.position[b]
    set_limits(cables, row, b, body, p, r, LEAST_TENSION_FACTOR, poses)
    first_tensions(cables, row, b, p, r, poses)
    out = seek(cables, row, b, body, r, external, line, poses, work)
    steps = out.steps
    changed = limits_moved(cables, row, b, body, out.rotation, poses)
    rounds = int(1)
    while (
        poses.column.shape[1] > poses.tension.shape[1] and changed and out.status == MARGIN_SOLVED
    ):
        out = seek(cables, row, b, body, out.rotation, external, line, poses, work)
        steps += out.steps
        rounds += 1
        changed = rounds < POSITION_FIT_ROUNDS and limits_moved(
            cables, row, b, body, out.rotation, poses
        )
    out.steps = steps
    poses.status[b] = out.status
    poses.margin[b] = out.margin
    poses.gap[b] = out.gap
    poses.steps[b] = poses.steps[b] + out.steps
    poses.rotation[b] = out.rotation
    poses.stable[b] = 0
    if out.status == MARGIN_SOLVED and out.margin >= ZERO:
        poses.stable[b] = judge_rest(cables, row, b, body, out.rotation, external, poses)
    return wp.where(out.status != MARGIN_UNSOLVED, 1 + poses.stable[b], 0)


@wp.kernel
def hold(
    cables: wp.array2d(dtype=Cable),
    bodies: wp.array(dtype=StaticBody),
    external: vec6d,
    first: wp.array(dtype=int),
    poses: Poses,
    work: MarginWork,
):
    """Hold one line of poses per thread; each free rotation starts from its neighbour."""
    line = wp.tid()
    n = poses.tension.shape[1]
    free = poses.column.shape[1] - n
    body = bodies[0]
    attempts = wp.where(free > 0, HOLD_ATTEMPTS, 1)
    warm = int(-1)
    for b in range(first[line], first[line + 1]):
        home = poses.rotation[b]
        poses.steps[b] = 0
        best = int(-1)
        chosen = int(-1)
        if warm >= 0:
            for i in range(n):
                poses.tension[b, i] = poses.tension[warm, i]
            best = try_from(cables, 0, b, body, poses.rotation[warm], external, line, poses, work)
        attempt = int(0)
        while best < RANK_STABLE and attempt < attempts:
            r = start_cold(cables, 0, b, body, tilted(attempt, home), poses)
            rank = try_from(cables, 0, b, body, r, external, line, poses, work)
            if rank > best or attempt == 0:
                best = rank
                chosen = attempt
            attempt += 1
        if chosen >= 0 and chosen < attempt - 1:
            r = start_cold(cables, 0, b, body, tilted(chosen, home), poses)
            best = try_from(cables, 0, b, body, r, external, line, poses, work)
        warm = wp.where(free > 0 and best == RANK_STABLE, b, -1)


@wp.kernel
def margins(
    column: wp.array2d(dtype=vec6d),
    target: wp.array(dtype=vec6d),
    lower: wp.array2d(dtype=wp.float64),
    upper: wp.array2d(dtype=wp.float64),
    work: MarginWork,
    tension: wp.array2d(dtype=wp.float64),
    margin: wp.array(dtype=wp.float64),
    gap: wp.array(dtype=wp.float64),
    status: wp.array(dtype=int),
):
    """Solve one wrench per thread."""
    b = wp.tid()
    n = column.shape[1]
    best = largest_margin(column, b, n, n, target[b], ZERO, lower, upper, b, work, tension)
    margin[b] = best.margin
    gap[b] = best.gap
    status[b] = best.status
