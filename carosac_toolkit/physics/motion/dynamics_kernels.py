"""A rigid platform on cables without inertia of their own: catenaries, or straight springs.

Each time step is one implicit step (`body_kernels`). The tension vector q of each catenary is
an unknown beside the pose, eliminated by its own 3x3 block as in the statics, so that a Newton step
costs one evaluation a cable. A third of each cable's mass moves with its anchor point: the inertia
of a straight cable that swings about its exit, and so does its air drag.
"""

import warp as wp

from carosac_toolkit.physics.cable.catenary_kernels import (
    ZERO,
    density_of,
    vec6d,
)
from carosac_toolkit.physics.cable.straight_line_kernels import straight_cable
from carosac_toolkit.physics.device_kernels import Cable
from carosac_toolkit.physics.motion.body_kernels import (
    FAST_MOTION_SHARE,
    BodyMotion,
    DynamicBody,
    Gusts,
    Newton,
    Scheme,
    System,
    at_rest,
    attach,
    blow,
    finish,
    inertial_system,
    moved,
    rate_after,
    rate_felt,
    scheme_of,
    solve_system,
    world_inertia,
)
from carosac_toolkit.physics.motion.capstan_kernels import grips
from carosac_toolkit.physics.motion.friction_kernels import Bristles, rub, rubs, turn_since
from carosac_toolkit.physics.motion.pull_kernels import Pull, sagging_pull, straight_pull
from carosac_toolkit.physics.motion.winch_kernels import resting
from carosac_toolkit.physics.motion.world_kernels import (
    NEWTON_STEP_MIN,
    NEWTON_STEPS_MAX,
    STEPS_ALIKE,
    Plants,
    Worlds,
    clock_after,
    clock_of,
    is_lost,
    is_nonsense,
    publish,
    roughness,
    start_anchor,
    turn_back,
    turn_winches,
)

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

SNAP_TENSION_CHANGE = wp.constant(
    wp.float64(0.5)
)  # share by which a tension changes in a step that snaps
MOTION_CLOSURE_MAX = wp.constant(
    wp.float64(1.0e-6)
)  # of the typical length: a larger closure asks for another step
SAGGING_MODEL = wp.constant(0)
RELEASE_EVALUATIONS = wp.constant(3)  # evaluations after which free cables are closed


@wp.struct
class Hung:
    """Cables without nodes."""

    q: wp.array2d(dtype=wp.vec3d)  # tension vector at the exit [N]
    inverse: wp.array2d(dtype=wp.mat33d)  # (d closure / d q)^-1 [N/m]
    tension: wp.array2d(dtype=wp.float64)  # scratch: at the anchor point [N]
    bristles: wp.array2d(dtype=Bristles)  # scratch: at the end of the step


@wp.func
def anchor_mass(cable: Cable, length: wp.float64, gravity: wp.float64) -> wp.float64:
    """Return the mass that moves with the anchor point [kg]."""
    return density_of(cable, gravity) * length / wp.float64(3.0)


@wp.struct
class MotionLoad:
    """All cables at a trial motion."""

    system: System
    gap: wp.float64


@wp.func
def load_anchors(plants: Plants, worlds: Worlds, hung: Hung, b: int, row: int, model: int,
                 body: DynamicBody, start: BodyMotion, trial: BodyMotion, system: System,
                 scheme: Scheme) -> MotionLoad:  # fmt: skip
    """Add pull, inertia and friction of each cable; correct q to first order."""
    out = MotionLoad()
    total = system
    turned = turn_since(start, trial)
    for i in range(worlds.winch.shape[1]):
        cable = plants.cables[row, i]
        winch = worlds.winch[b, i]
        arm = trial.rotation * (cable.anchor_point - body.center_of_mass)
        anchor = trial.center + arm
        velocity = trial.velocity + wp.cross(trial.angular_velocity, arm)
        pull = Pull()
        if model == SAGGING_MODEL:
            pull = sagging_pull(
                cable,
                worlds.bristles[b, i].run,
                hung.q[b, i],
                anchor,
                velocity,
                winch.length,
                winch.rate,
                scheme.reach,
                body.size,
            )
            hung.q[b, i] = pull.q
            hung.inverse[b, i] = pull.inverse
        else:
            pull = straight_pull(
                cable, worlds.bristles[b, i].run, anchor, velocity, winch.length, winch.rate,
                scheme.reach,
            )  # fmt: skip
        out.gap = wp.max(out.gap, pull.gap)
        hung.tension[b, i] = wp.length(pull.force)
        force = pull.force
        k = pull.stiffness
        if model == SAGGING_MODEL:
            mass = anchor_mass(cable, winch.length, body.gravity)
            felt = rate_felt(
                scheme, worlds.anchor_velocity[b, i], worlds.anchor_rate[b, i], velocity
            )
            force = force - mass * (felt + body.cable_drag * velocity)
            inertia = mass * (scheme.stiff + body.cable_drag / scheme.reach)
            k = k + inertia * wp.identity(n=3, dtype=wp.float64)
        if rubs(cable):
            before = start.center + start.rotation * (cable.anchor_point - body.center_of_mass)
            rubbing = rub(cable, worlds.bristles[b, i], before, anchor, turned, body.size)
            force = force + rubbing.force
            k = k + rubbing.stiffness
            total.moment = total.moment + rubbing.moment
            total.rr = total.rr + rubbing.turning
            bristles = rubbing.bristles
            bristles.run = pull.run
            hung.bristles[b, i] = bristles
        total = attach(total, arm, force, k)
    out.system = total
    return out


@wp.func
def carry_cables(plants: Plants, hung: Hung, b: int, row: int, body: DynamicBody, trial: BodyMotion,
                 move: wp.vec3d, turn: wp.vec3d):  # fmt: skip
    """Update tension vectors after a small motion of the platform, to first order."""
    for i in range(hung.q.shape[1]):
        arm = trial.rotation * (plants.cables[row, i].anchor_point - body.center_of_mass)
        hung.q[b, i] = hung.q[b, i] - hung.inverse[b, i] * (move + wp.cross(turn, arm))


@wp.func
def keep_anchors(plants: Plants, worlds: Worlds, hung: Hung, b: int, row: int, body: DynamicBody,
                 scheme: Scheme):  # fmt: skip
    """Store anchor velocities and tensions at the end of a time step."""
    motion = worlds.motion[b]
    snap = bool(False)
    for i in range(worlds.winch.shape[1]):
        before = worlds.tension[b, i]
        now = hung.tension[b, i]
        if wp.abs(now - before) > SNAP_TENSION_CHANGE * wp.max(now, before):
            snap = True
        worlds.tension[b, i] = now
        arm = motion.rotation * (plants.cables[row, i].anchor_point - body.center_of_mass)
        velocity = motion.velocity + wp.cross(motion.angular_velocity, arm)
        worlds.anchor_rate[b, i] = rate_after(
            scheme, worlds.anchor_velocity[b, i], worlds.anchor_rate[b, i], velocity
        )
        worlds.anchor_velocity[b, i] = velocity
        if rubs(plants.cables[row, i]):
            worlds.bristles[b, i] = hung.bristles[b, i]
    worlds.rough[b] = roughness(worlds.rough[b], snap)


@wp.func
def time_step(plants: Plants, worlds: Worlds, hung: Hung, b: int, row: int, model: int,
              h: wp.float64, ticks: int) -> int:  # fmt: skip
    """Take one implicit step; lengths are those at its end already. Return 1 if it was taken.

    A step without a solution is taken only if it is as short as can be, one of the `ticks`.
    """
    body = plants.bodies[row]
    start = worlds.motion[b]
    gusts = blow(plants.winds[row], worlds.gusts[b], worlds.time[b] + h, worlds.seed[b])
    scheme = scheme_of(h, worlds.last[b], worlds.rough[b] > 0, FAST_MOTION_SHARE)
    velocity = start.velocity + h * start.velocity_rate
    omega = start.angular_velocity + h * start.angular_rate
    trial = moved(start, scheme, velocity, omega)
    count = int(0)
    going = bool(True)
    solved = bool(False)
    size = wp.float64(0.0)
    while going:
        system = inertial_system(body, start, trial, scheme, gusts.force)
        loaded = load_anchors(
            plants, worlds, hung, b, row, model, body, start, trial, system, scheme
        )
        newton = solve_system(loaded.system)
        velocity += newton.move / scheme.reach
        omega += newton.turn / scheme.reach
        if model == SAGGING_MODEL:
            carry_cables(plants, hung, b, row, body, trial, newton.move, newton.turn)
        trial = moved(start, scheme, velocity, omega)
        count += 1
        size = wp.length(newton.move) + body.arm * wp.length(newton.turn)
        solved = size < NEWTON_STEP_MIN * body.size and loaded.gap < MOTION_CLOSURE_MAX * body.size
        going = (not solved) and count < NEWTON_STEPS_MAX
    if not solved and ticks > 1:
        return 0
    worlds.iterations[b] = wp.max(worlds.iterations[b], count)
    worlds.residual[b] = wp.max(worlds.residual[b], size)
    if not solved:
        worlds.capped[b] = worlds.capped[b] + 1
    if not size < body.size or is_lost(trial, body, plants.cables[row, 0].exit_point):
        worlds.failed[b] = 1
    else:
        worlds.motion[b] = finish(body, start, trial, scheme)
        worlds.gusts[b] = gusts
        worlds.time[b] = worlds.time[b] + h
        worlds.last[b] = h
        keep_anchors(plants, worlds, hung, b, row, body, scheme)
    return 1


@wp.kernel
def advance(plants: Plants, worlds: Worlds, hung: Hung, model: int, follow: int, count: int,
            h: wp.float64):  # fmt: skip
    """Advance each world by `count` time steps of h; one thread a world."""
    b = wp.tid()
    row = wp.min(b, plants.bodies.shape[0] - 1)
    worlds.iterations[b] = 0
    worlds.capped[b] = 0
    worlds.residual[b] = ZERO
    worlds.failed[b] = wp.max(worlds.failed[b], is_nonsense(worlds, b))
    clock = clock_of(h, count)
    while clock.done < clock.ticks and worlds.failed[b] == 0:
        step = clock.tick * wp.float64(clock.size)
        left = clock.tick * wp.float64(clock.ticks - clock.done)
        turn_winches(plants, worlds, b, row, step, left, follow, 0, 1)
        taken = time_step(plants, worlds, hung, b, row, model, step, clock.size)
        if taken == 0 or worlds.failed[b] == 1:
            turn_back(worlds, b, 0, 1)
        clock = clock_after(clock, taken)
    publish(plants, worlds, b, row, 0, 1)


@wp.struct
class Freed:
    """Initial states of worlds, at rest or not."""

    position: wp.array(dtype=wp.vec3d)  # platform origin in W [m]
    rotation: wp.array(dtype=wp.mat33d)
    twist: wp.array(dtype=vec6d)  # of the platform origin in W
    force: wp.array(dtype=wp.vec3d)  # on the centre of mass, held from now on [N]
    unstrained_length: wp.array2d(dtype=wp.float64)  # [m]
    rate: wp.array2d(dtype=wp.float64)  # of the lengths [m/s]
    bristles: wp.array2d(dtype=Bristles)  # of dry friction
    bent: wp.array(dtype=int)  # 1 where these are known; 0: as if it had been sliding


@wp.kernel
def release(
    plants: Plants, worlds: Worlds, hung: Hung, freed: Freed, model: int, h: wp.float64,
    instant: wp.float64,
):  # fmt: skip
    """Release worlds with the acceleration that their forces give; steps of `h` follow.

    With that acceleration the first step needs no past, and is of second order like all others. It
    is found by one Euler step of an `instant` [s], in which nothing moves. Impacts do not change
    the scheme: motions let go side by side are compared, and two schemes differ by more than they
    do.
    """
    b = wp.tid()
    row = wp.min(b, plants.bodies.shape[0] - 1)
    body = plants.bodies[row]
    twist = freed.twist[b]
    omega = wp.vec3d(twist[3], twist[4], twist[5])
    start = at_rest(
        body, freed.position[b], freed.rotation[b], wp.vec3d(twist[0], twist[1], twist[2]), omega
    )
    gusts = Gusts()
    gusts.force = freed.force[b]
    worlds.gusts[b] = gusts
    worlds.time[b] = ZERO
    worlds.last[b] = h
    worlds.rough[b] = STEPS_ALIKE
    worlds.failed[b] = 0
    worlds.motion[b] = start
    for i in range(worlds.winch.shape[1]):
        winch = resting(freed.unstrained_length[b, i])
        winch.rate = freed.rate[b, i]
        winch.wound_rate = freed.rate[b, i]
        worlds.winch[b, i] = winch
        start_anchor(plants, worlds, b, row, i, start)
        if freed.bent[b] == 1:
            bristles = freed.bristles[b, i]
            bristles.run.known = 0  # a length or pose that was corrected is no slip
            worlds.bristles[b, i] = bristles
    scheme = scheme_of(instant, ZERO, True, FAST_MOTION_SHARE)
    trial = moved(start, scheme, start.velocity, omega)
    newton = Newton()
    for _ in range(RELEASE_EVALUATIONS):  # the first times close the cables
        system = inertial_system(body, start, trial, scheme, gusts.force)
        loaded = load_anchors(
            plants, worlds, hung, b, row, model, body, start, trial, system, scheme
        )
        newton = solve_system(loaded.system)
    start.velocity_rate = newton.move / (scheme.reach * instant)
    start.angular_rate = newton.turn / (scheme.reach * instant)
    jw = world_inertia(body, start.rotation)
    start.spin_rate = jw * start.angular_rate + wp.cross(omega, start.spin)
    start.acceleration = start.velocity_rate
    start.angular_acceleration = start.angular_rate
    worlds.motion[b] = start
    for i in range(worlds.winch.shape[1]):
        arm = start.rotation * (plants.cables[row, i].anchor_point - body.center_of_mass)
        worlds.anchor_rate[b, i] = (
            start.velocity_rate
            + wp.cross(start.angular_rate, arm)
            + wp.cross(omega, wp.cross(omega, arm))
        )
        worlds.tension[b, i] = hung.tension[b, i]
        if grips(plants.cables[row, i]):
            bristles = worlds.bristles[b, i]
            bristles.run = hung.bristles[b, i].run
            worlds.bristles[b, i] = bristles
    publish(plants, worlds, b, row, 0, 1)


@wp.kernel
def place_hung(which: wp.array(dtype=int), q: wp.array2d(dtype=wp.vec3d), hung: Hung):
    """Store tension vectors of worlds that are placed; one thread a row of `which`."""
    k = wp.tid()
    for i in range(q.shape[1]):
        hung.q[which[k], i] = q[k, i]


@wp.kernel
def straight_points(plants: Plants, worlds: Worlds, points: wp.array3d(dtype=wp.vec3d)):
    """Compute points on straight cables, tangent point to anchor; a thread a world and cable."""
    b, i = wp.tid()
    cable = plants.cables[wp.min(b, plants.bodies.shape[0] - 1), i]
    anchor = worlds.position[b] + worlds.rotation[b] * cable.anchor_point
    span, wrap, unit, _bend, _valid = straight_cable(
        anchor - cable.exit_point, cable.pulley_radius, cable.swivel_axis
    )
    last = points.shape[2] - 1
    for k in range(points.shape[2]):
        share = wp.float64(last - k) / wp.float64(last)
        points[b, i, k] = anchor - (share * (span - wrap * cable.pulley_radius)) * unit
