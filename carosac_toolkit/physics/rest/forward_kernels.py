"""Forward kinematics: the pose where a platform and its sagging cables are at rest.

Newton on the platform's six coordinates; each cable's tension vector is an unknown beside them and
is eliminated by its own 3x3 block, so any number of cables costs one 6x6 solve. Far from rest each
cable is closed by its own iteration first; near it, one evaluation a step is enough.
"""

import warp as wp

from carosac_toolkit.physics.cable.catenary_kernels import (
    HALF,
    TWO,
    ZERO,
    guess_cable,
    hang,
    inverse33,
    settle,
    vec6d,
)
from carosac_toolkit.physics.cable.straight_line_kernels import straight_to
from carosac_toolkit.physics.device_kernels import Cable, StaticBody, anchor_of
from carosac_toolkit.physics.rest.platform_kernels import (
    Poses,
    WrenchBalance,
    add_lever,
    cable_stiffness,
    descent_step,
    gravity_balance,
    scaled_norm,
    translation,
    turned,
)
from carosac_toolkit.physics.rest.start_kernels import cold_start

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

REST_CABLE_STEPS_MAX = wp.constant(60)  # steps of one cable
REST_STEPS_MAX = wp.constant(100)  # steps of the platform
WARM_STEPS_MAX = wp.constant(20)
REST_RESIDUAL_PER_WEIGHT = wp.constant(wp.float64(1.0e-10))  # of the weight
CLOSURE_ROUNDING = wp.constant(wp.float64(2.0e-14))  # of that length: rounding of the coordinates
REST_CLOSURE_MAX = wp.constant(wp.float64(1.0e-13))  # of the typical cable length
START_COLD = wp.constant(0)  # no guess: the pose given is home
START_AT_POSE = wp.constant(1)  # a pose is given
START_WARM = wp.constant(2)  # a pose and tension vectors are given


@wp.struct
class PoseLoad:
    """All cables at one pose."""

    balance: WrenchBalance
    gap: wp.float64  # largest closure [m]


@wp.struct
class RestSearch:
    """End of the Newton iteration."""

    position: wp.vec3d
    rotation: wp.mat33d
    balance: WrenchBalance
    residual: wp.float64  # [N]
    gap: wp.float64  # [m]
    pivot_min: wp.float64
    converged: int
    steps: int


@wp.func
def load_cables(cables: wp.array2d(dtype=Cable), row: int, b: int, body: StaticBody,
                p: wp.vec3d, r: wp.mat33d, loose: wp.float64,
                poses: Poses) -> PoseLoad:  # fmt: skip
    """Close the cables to `loose`, add up wrench and stiffness, correct q to first order.

    A closure of the size of rounding is left alone: a stiff cable would turn it into newtons.
    """
    out = PoseLoad()
    out.balance = gravity_balance(body, r)
    for i in range(poses.unstrained_length.shape[1]):
        anchor = anchor_of(cables[row, i], p, r)
        s = settle(
            poses.q[b, i],
            anchor,
            poses.unstrained_length[b, i],
            cables[row, i],
            loose,
            REST_CABLE_STEPS_MAX,
        )
        poses.inverse[b, i] = s.inverse
        out.gap = wp.max(out.gap, wp.length(s.hanging.closure))
        rest = wp.vec3d()
        if wp.length(s.hanging.closure) > CLOSURE_ROUNDING * body.size:
            rest = s.inverse * s.hanging.closure
        poses.q[b, i] = s.q - rest
        force = s.hanging.force - s.hanging.force_q * rest
        poses.tension[b, i] = wp.length(force)
        k = cable_stiffness(s.hanging, s.inverse)
        out.balance = add_lever(out.balance.stiffness, out.balance.wrench, anchor - p, force, k)
    return out


@wp.func
def relax(cables: wp.array2d(dtype=Cable), row: int, b: int, body: StaticBody, p0: wp.vec3d,
          r0: wp.mat33d, limit: int, poses: Poses) -> RestSearch:  # fmt: skip
    """Solve for rest by Newton; halve a step along which the wrench has reversed and grown."""
    n = poses.unstrained_length.shape[1]
    out = RestSearch()
    out.position = p0
    out.rotation = r0
    p = p0
    r = r0
    loose = wp.float64(1.0e-3) * body.size
    step = vec6d()
    slope = wp.float64(0.0)
    halvings = int(0)
    while out.converged == 0 and out.steps < limit:
        here = load_cables(cables, row, b, body, p, r, loose, poses)
        out.steps += 1
        norm = scaled_norm(here.balance.wrench, body.arm)
        settled = norm <= REST_RESIDUAL_PER_WEIGHT * body.weight
        power = wp.abs(wp.dot(step, here.balance.wrench))
        overshot = out.steps > 1 and power > wp.float64(0.9) * slope and not settled
        if overshot and halvings < 30:
            loose = wp.float64(1.0e-12) * body.size
            step = step * HALF
            slope = slope * HALF
            halvings += 1
            p = out.position + translation(step)
            r = turned(out.rotation, step)
            for i in range(n):
                anchor = anchor_of(cables[row, i], p, r)
                poses.q[b, i] = guess_cable(anchor, poses.unstrained_length[b, i], cables[row, i])
        else:
            halvings = 0
            out.position = p
            out.rotation = r
            out.balance = here.balance
            out.residual = norm
            out.gap = here.gap
            newton = descent_step(here.balance, body, wp.float64(0.1), wp.float64(0.3))
            out.pivot_min = newton.pivot_min
            if settled and here.gap <= REST_CLOSURE_MAX * body.size:
                out.converged = 1
            else:
                step = newton.step
                slope = wp.dot(step, here.balance.wrench)
                move = translation(step)
                turn = wp.vec3d(step[3], step[4], step[5])
                for i in range(n):
                    arm = r * cables[row, i].anchor_point
                    poses.q[b, i] = poses.q[b, i] - poses.inverse[b, i] * (
                        move + wp.cross(turn, arm)
                    )
                p = out.position + move
                r = turned(out.rotation, step)
    return out


@wp.func
def start_cables(cables: wp.array2d(dtype=Cable), row: int, b: int, p: wp.vec3d, r: wp.mat33d,
                 poses: Poses):  # fmt: skip
    """Guess tension vectors after a cold start: by its forces if taut, else by geometry."""
    for i in range(poses.unstrained_length.shape[1]):
        cable = cables[row, i]
        anchor = anchor_of(cable, p, r)
        load = cable.weight_per_length * poses.unstrained_length[b, i]
        if poses.tension[b, i] > TWO * load:
            straight = straight_to(cable, anchor)
            poses.q[b, i] = poses.tension[b, i] * straight.unit + wp.vec3d(ZERO, ZERO, HALF * load)
        else:
            poses.q[b, i] = guess_cable(anchor, poses.unstrained_length[b, i], cable)


@wp.func
def is_near(cables: wp.array2d(dtype=Cable), row: int, b: int, p: wp.vec3d, r: wp.mat33d,
            poses: Poses) -> bool:  # fmt: skip
    """Return true if closing the cables at a guess at most triples any tension vector.

    Stiff cables on a guess some millimetres away would start from forces that mean nothing. With
    fewer than six cables the platform gives way, and Newton copes.
    """
    if poses.unstrained_length.shape[1] < 6:
        return True
    for i in range(poses.unstrained_length.shape[1]):
        state = hang(
            poses.q[b, i],
            anchor_of(cables[row, i], p, r),
            poses.unstrained_length[b, i],
            cables[row, i],
        )
        change = inverse33(state.closure_q) * state.closure
        if not wp.length(change) <= TWO * wp.length(poses.q[b, i]):
            return False
    return True


@wp.kernel
def forward(
    cables: wp.array2d(dtype=Cable), bodies: wp.array(dtype=StaticBody), start: int, poses: Poses
):
    """Solve one pose per thread; position and rotation hold the guess, then the answer."""
    b = wp.tid()
    row = wp.min(b, cables.shape[0] - 1)
    body = bodies[wp.min(b, bodies.shape[0] - 1)]
    p = poses.position[b]
    r = poses.rotation[b]
    rest = RestSearch()
    steps = int(0)
    if start == START_AT_POSE:
        for i in range(poses.unstrained_length.shape[1]):
            anchor = anchor_of(cables[row, i], p, r)
            poses.q[b, i] = guess_cable(anchor, poses.unstrained_length[b, i], cables[row, i])
    near = start != START_COLD
    if start == START_WARM:
        near = is_near(cables, row, b, p, r, poses)
    if near:
        rest = relax(cables, row, b, body, p, r, WARM_STEPS_MAX, poses)
        steps = rest.steps
    if rest.converged == 0:
        first = cold_start(cables, row, b, body, p, r, poses)
        start_cables(cables, row, b, first.position, first.rotation, poses)
        rest = relax(cables, row, b, body, first.position, first.rotation, REST_STEPS_MAX, poses)
        steps += rest.steps + first.steps
    poses.position[b] = rest.position
    poses.rotation[b] = rest.rotation
    poses.stiffness[b] = rest.balance.stiffness
    poses.residual[b] = rest.residual
    poses.closure[b] = rest.gap
    poses.status[b] = rest.converged
    poses.stable[b] = wp.where(rest.pivot_min > ZERO, 1, 0)
    poses.steps[b] = steps
