"""Inverse kinematics with the rotation held: a choice of tensions within their limits.

Each cable's tension at the platform is an unknown; its length and direction follow from it (sag,
pulley and run included). The cables are linearised anew until the tensions stay.
"""

import warp as wp

from carosac_toolkit.physics.cable.catenary_kernels import ZERO, vec6d
from carosac_toolkit.physics.cable.tension_kernels import (
    LEAST_TENSION_FACTOR,
    Pulling,
    guess_pull,
    lowest_allowed,
    pull,
)
from carosac_toolkit.physics.device_kernels import Cable, StaticBody, anchor_of
from carosac_toolkit.physics.rest.distribution_kernels import Cost, distributed_tensions, set_cost
from carosac_toolkit.physics.rest.forward_kernels import PoseLoad, load_cables
from carosac_toolkit.physics.rest.platform_kernels import (
    Poses,
    add_lever,
    factorise,
    gravity_balance,
    scaled_norm,
)

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

TENSION_STEPS_MAX = wp.constant(80)
TENSION_RESIDUAL_PER_WEIGHT = wp.constant(wp.float64(1.0e-11))  # of the weight
TENSION_CHANGE_PER_WEIGHT = wp.constant(wp.float64(1.0e-9))  # change of tension, of the weight

STATUS_FAILED = wp.constant(0)
STATUS_CONVERGED = wp.constant(1)
STATUS_INFEASIBLE = wp.constant(2)


@wp.func
def scaled_force(force: wp.vec3d, moment: wp.vec3d, arm: wp.float64) -> vec6d:
    """Return a wrench with its moment divided by the typical lever arm [N]."""
    m = moment / arm
    return vec6d(force[0], force[1], force[2], m[0], m[1], m[2])


@wp.func
def pull_cables(cables: wp.array2d(dtype=Cable), row: int, b: int, body: StaticBody, p: wp.vec3d,
                r: wp.mat33d, poses: Poses) -> PoseLoad:  # fmt: skip
    """Evaluate cables of known tension at a pose: wrench, stiffness at that tension, columns.

    A column is d wrench / d tension, its moment divided by the typical lever arm.
    """
    out = PoseLoad()
    out.balance = gravity_balance(body, r)
    for i in range(poses.tension.shape[1]):
        anchor = anchor_of(cables[row, i], p, r)
        g = Pulling()
        g.q = poses.q[b, i]
        g.unstrained_length = poses.unstrained_length[b, i]
        g = pull(g, anchor, poses.tension[b, i], cables[row, i], wp.float64(1.0e-14), 40)
        poses.q[b, i] = g.q
        poses.unstrained_length[b, i] = g.unstrained_length
        out.gap = wp.max(out.gap, wp.length(g.hanging.closure))
        arm = anchor - p
        out.balance = add_lever(
            out.balance.stiffness, out.balance.wrench, arm, g.hanging.force, g.stiffness
        )
        poses.column[b, i] = scaled_force(g.force_t, wp.cross(arm, g.force_t), body.arm)
    return out


@wp.func
def scaled_wrench(wrench: vec6d, arm: wp.float64) -> vec6d:
    """Return the wrench with its moment divided by the typical lever arm [N]."""
    w = wrench
    for i in range(3):
        w[3 + i] = w[3 + i] / arm
    return w


@wp.func
def set_limits(cables: wp.array2d(dtype=Cable), row: int, b: int, body: StaticBody, p: wp.vec3d,
               r: wp.mat33d, margin: wp.float64, poses: Poses):  # fmt: skip
    """Set the limits of the tensions at a pose."""
    for i in range(poses.lower.shape[1]):
        anchor = anchor_of(cables[row, i], p, r)
        poses.upper[b, i] = cables[row, i].tension_max
        lowest = lowest_allowed(anchor, cables[row, i], body.weight, margin)
        poses.lower[b, i] = wp.min(lowest, poses.upper[b, i])


@wp.func
def first_tensions(cables: wp.array2d(dtype=Cable), row: int, b: int, p: wp.vec3d, r: wp.mat33d,
                   poses: Poses):  # fmt: skip
    """Start from straight cables with tensions clipped to their limits."""
    for i in range(poses.tension.shape[1]):
        poses.tension[b, i] = wp.clamp(poses.tension[b, i], poses.lower[b, i], poses.upper[b, i])
        g = guess_pull(anchor_of(cables[row, i], p, r), poses.tension[b, i], cables[row, i])
        poses.q[b, i] = g.q
        poses.unstrained_length[b, i] = g.unstrained_length


@wp.func
def cost_of(choice: int, poses: Poses) -> Cost:
    """Return a cost of the tensions in the buffers of the poses."""
    cost = Cost()
    cost.choice = choice
    cost.reference = poses.reference
    cost.scale = poses.scale
    cost.middle = poses.middle
    cost.softness = poses.softness
    cost.iterate = poses.iterate
    return cost


@wp.kernel
def inverse_held(cables: wp.array2d(dtype=Cable), bodies: wp.array(dtype=StaticBody), choice: int,
                 poses: Poses):  # fmt: skip
    """Choose tensions within limits, rotation held; linearise cables anew until nothing changes."""
    b = wp.tid()
    n = poses.tension.shape[1]
    row = wp.min(b, cables.shape[0] - 1)
    body = bodies[wp.min(b, bodies.shape[0] - 1)]
    p = poses.position[b]
    r = poses.rotation[b]
    set_limits(cables, row, b, body, p, r, LEAST_TENSION_FACTOR, poses)
    for i in range(n):
        poses.reference[b, i] = ZERO
        poses.tension[b, i] = body.weight
    first_tensions(cables, row, b, p, r, poses)
    cost = cost_of(choice, poses)
    set_cost(cost, poses.lower, poses.upper, b, body.weight)
    count = int(0)
    result = int(-1)
    refused = int(0)
    while result < 0:
        here = pull_cables(cables, row, b, body, p, r, poses)
        count += 1
        target = -scaled_wrench(here.balance.wrench, body.arm)
        norm = wp.length(target)
        for i in range(n):
            target = target + poses.tension[b, i] * poses.column[b, i]
        feasible = distributed_tensions(
            poses.column, poses.lower, poses.upper, cost, b, target, poses.wanted
        )
        refused = wp.where(feasible == 1, 0, refused + 1)
        jump = wp.float64(0.0)
        for i in range(n):
            jump = wp.max(jump, wp.abs(poses.wanted[b, i] - poses.tension[b, i]))
        if (
            feasible == 1
            and norm <= TENSION_RESIDUAL_PER_WEIGHT * body.weight
            and jump <= TENSION_CHANGE_PER_WEIGHT * body.weight
        ):
            result = STATUS_CONVERGED
        elif refused >= 4:
            result = STATUS_INFEASIBLE
        elif count >= TENSION_STEPS_MAX:
            result = STATUS_FAILED
        else:
            for i in range(n):
                poses.tension[b, i] = poses.wanted[b, i]
    poses.status[b] = result
    poses.steps[b] = count


@wp.func
def judge_pose(cables: wp.array2d(dtype=Cable), row: int, b: int, body: StaticBody, r: wp.mat33d,
               external: vec6d, poses: Poses) -> int:  # fmt: skip
    """Set wrench left, closure, stiffness of a pose from its lengths alone; 1 if it is stable."""
    loose = wp.float64(1.0e-13) * body.size
    here = load_cables(cables, row, b, body, poses.position[b], r, loose, poses)
    f = factorise(here.balance.stiffness)
    poses.stiffness[b] = here.balance.stiffness
    poses.residual[b] = scaled_norm(here.balance.wrench + external, body.arm)
    poses.closure[b] = here.gap
    return wp.where(f.pivot_min > ZERO, 1, 0)


@wp.kernel
def evaluate(cables: wp.array2d(dtype=Cable), bodies: wp.array(dtype=StaticBody), poses: Poses):
    """Judge one pose per thread by its lengths alone."""
    b = wp.tid()
    row = wp.min(b, cables.shape[0] - 1)
    body = bodies[wp.min(b, bodies.shape[0] - 1)]
    poses.stable[b] = judge_pose(cables, row, b, body, poses.rotation[b], vec6d(), poses)
