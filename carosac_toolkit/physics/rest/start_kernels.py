"""A first pose without a guess: straight, inextensible, unilateral cables under the weight.

Augmented Lagrangian: cable i pulls with t_i = max(0, m_i + k (d_i - L_i)), m_i being its force of
the last round. The spring k is soft, so that each round is a well-conditioned minimisation of
energy by a damped Newton method; the multipliers m_i carry the lengths to their values.
"""

import warp as wp

from carosac_toolkit.physics.cable.catenary_kernels import HALF, TWO, ZERO
from carosac_toolkit.physics.cable.straight_line_kernels import straight_to
from carosac_toolkit.physics.device_kernels import Cable, StaticBody, anchor_of
from carosac_toolkit.physics.rest.platform_kernels import (
    Poses,
    WrenchBalance,
    add_lever,
    descent_step,
    gravity_balance,
    scaled_norm,
    translation,
    turned,
)

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

MULTIPLIER_ROUNDS_MAX = wp.constant(12)
SOFT_STEPS_MAX = wp.constant(25)
POSITION_FIT_ROUNDS = wp.constant(4)  # of fitting straight cables to a position
START_TILT_RAD = wp.constant(wp.float64(0.7))  # of further rotations to start from
STRETCH_UNDER_WEIGHT = wp.constant(
    wp.float64(0.03)
)  # stretch under the weight, as a share of cable length


@wp.struct
class StraightStart:
    """The pose reached."""

    position: wp.vec3d
    rotation: wp.mat33d
    steps: int


@wp.func
def soft_energy(cables: wp.array2d(dtype=Cable), row: int, b: int, body: StaticBody,
                p: wp.vec3d, r: wp.mat33d, k: wp.float64, poses: Poses) -> wp.float64:  # fmt: skip
    """Return the energy of the augmented problem [J]."""
    center = p + r * body.center_of_mass
    energy = body.weight * center[2]
    for i in range(poses.unstrained_length.shape[1]):
        s = straight_to(cables[row, i], anchor_of(cables[row, i], p, r))
        t = wp.max(poses.tension[b, i] + k * (s.length - poses.unstrained_length[b, i]), ZERO)
        energy += HALF * t * t / k
    return energy


@wp.func
def soft_balance(cables: wp.array2d(dtype=Cable), row: int, b: int, body: StaticBody,
                 p: wp.vec3d, r: wp.mat33d, k: wp.float64,
                 poses: Poses) -> WrenchBalance:  # fmt: skip
    """Return wrench and stiffness of the augmented problem."""
    total = gravity_balance(body, r)
    for i in range(poses.unstrained_length.shape[1]):
        anchor = anchor_of(cables[row, i], p, r)
        s = straight_to(cables[row, i], anchor)
        t = poses.tension[b, i] + k * (s.length - poses.unstrained_length[b, i])
        if t > ZERO:
            pull = k * wp.outer(s.unit, s.unit) + t * s.bend
            total = add_lever(total.stiffness, total.wrench, anchor - p, t * s.unit, pull)
    return total


@wp.func
def minimise(cables: wp.array2d(dtype=Cable), row: int, b: int, body: StaticBody,
             start: StraightStart, k: wp.float64, poses: Poses) -> StraightStart:  # fmt: skip
    """Minimise the energy of one round by damped Newton with Armijo line search."""
    out = start
    energy = soft_energy(cables, row, b, body, start.position, start.rotation, k, poses)
    for _step in range(SOFT_STEPS_MAX):
        p = out.position
        r = out.rotation
        total = soft_balance(cables, row, b, body, p, r, k, poses)
        out.steps += 1
        if scaled_norm(total.wrench, body.arm) < wp.float64(1.0e-2) * body.weight:
            break
        newton = descent_step(total, body, wp.float64(0.2), wp.float64(0.5))
        step = newton.step
        gain = wp.float64(1.0e-4) * wp.dot(step, total.wrench)
        after = energy
        for _half in range(20):
            out.position = p + translation(step)
            out.rotation = turned(r, step)
            after = soft_energy(cables, row, b, body, out.position, out.rotation, k, poses)
            if after <= energy - gain:
                break
            step = step * HALF
            gain = gain * HALF
        energy = after
    return out


@wp.func
def cold_start(cables: wp.array2d(dtype=Cable), row: int, b: int, body: StaticBody,
               p0: wp.vec3d, r0: wp.mat33d, poses: Poses) -> StraightStart:  # fmt: skip
    """Rest on straight inextensible cables, to about a millimetre; sets its tensions."""
    out = StraightStart()
    out.position = p0
    out.rotation = r0
    k = body.weight / (STRETCH_UNDER_WEIGHT * body.size)
    for i in range(poses.unstrained_length.shape[1]):
        poses.tension[b, i] = ZERO
    for _round in range(MULTIPLIER_ROUNDS_MAX):
        out = minimise(cables, row, b, body, out, k, poses)
        worst = wp.float64(0.0)
        for i in range(poses.unstrained_length.shape[1]):
            anchor = anchor_of(cables[row, i], out.position, out.rotation)
            s = straight_to(cables[row, i], anchor)
            t = wp.max(poses.tension[b, i] + k * (s.length - poses.unstrained_length[b, i]), ZERO)
            worst = wp.max(worst, wp.abs(t - poses.tension[b, i]) / k)
            poses.tension[b, i] = t
        if worst < wp.float64(1.0e-4) * body.size:
            break
        k = k * TWO
    return out


@wp.func
def fit_straight(cables: wp.array2d(dtype=Cable), row: int, b: int, body: StaticBody, p: wp.vec3d,
                 first: wp.mat33d, poses: Poses) -> wp.mat33d:  # fmt: skip
    """Return the rotation of a rest of straight cables near a position; set its tensions."""
    r = first
    for _round in range(POSITION_FIT_ROUNDS):
        for i in range(poses.tension.shape[1]):
            s = straight_to(cables[row, i], anchor_of(cables[row, i], p, r))
            poses.unstrained_length[b, i] = s.length
        nearby = cold_start(cables, row, b, body, p, r, poses)
        r = nearby.rotation
    return r
