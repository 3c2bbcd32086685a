"""Shared parts of all simulated worlds, in float64 Warp: plants, state, winches, wind."""

import warp as wp

from carosac_toolkit.physics.cable.catenary_kernels import vec6d
from carosac_toolkit.physics.device_kernels import Cable
from carosac_toolkit.physics.motion.body_kernels import (
    BodyMotion,
    DynamicBody,
    Gusts,
    Wind,
    at_rest,
    origin_acceleration,
    origin_of,
    origin_velocity,
)
from carosac_toolkit.physics.motion.friction_kernels import Bristles, rubs, slid_bristles
from carosac_toolkit.physics.motion.winch_kernels import (
    Winch,
    WinchState,
    resting,
    winch_advance,
)

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

CALM_STEPS = wp.constant(3)  # steps after which a change from slack to taut is over
STEPS_ALIKE = wp.constant(-1)  # in place of such steps: all steps alike, through impacts too
NEWTON_STEPS_MAX = wp.constant(12)  # Newton steps in one time step
STEP_PARTS_MAX = wp.constant(64)  # parts of a time step in which it may be taken where it fails
NEWTON_STEP_MIN = wp.constant(
    wp.float64(1.0e-8)
)  # of the typical cable length: a smaller Newton step of the platform is the last
LOST_DISTANCE_LENGTHS = wp.constant(
    wp.float64(100.0)
)  # typical cable lengths: farther from the exits is lost

SLIDING_TIME = wp.constant(
    wp.float64(0.1)
)  # of sqrt(size / gravity): how long a platform moved before it is put into motion


@wp.struct
class Plants:
    """The robots; with one row it serves all worlds."""

    cables: wp.array2d(dtype=Cable)
    bodies: wp.array(dtype=DynamicBody)
    winches: wp.array2d(dtype=Winch)
    winds: wp.array(dtype=Wind)


@wp.struct
class Worlds:
    """State of B worlds of n cables, and what the last call says about them."""

    motion: wp.array(dtype=BodyMotion)
    winch: wp.array2d(dtype=WinchState)
    winch_before: wp.array2d(dtype=WinchState)  # scratch
    anchor_velocity: wp.array2d(dtype=wp.vec3d)  # [m/s]
    anchor_rate: wp.array2d(dtype=wp.vec3d)
    bristles: wp.array2d(dtype=Bristles)  # of dry friction
    command: wp.array2d(dtype=wp.float64)  # [m]
    gusts: wp.array(dtype=Gusts)
    seed: wp.array(dtype=int)
    last: wp.array(dtype=wp.float64)  # size of the last step [s]; 0: there was none
    rough: wp.array(dtype=int)  # steps until an impact of a cable is over, or `STEPS_ALIKE`
    failed: wp.array(dtype=int)
    time: wp.array(dtype=wp.float64)  # since the last reset [s]
    position: wp.array(dtype=wp.vec3d)  # platform origin [m]
    rotation: wp.array(dtype=wp.mat33d)
    twist: wp.array(dtype=vec6d)
    acceleration: wp.array(dtype=vec6d)
    unstrained_length: wp.array2d(dtype=wp.float64)  # [m]
    wound_length: wp.array2d(dtype=wp.float64)  # what the drums have turned for [m]
    tension: wp.array2d(dtype=wp.float64)  # at the platform [N]
    iterations: wp.array(dtype=int)  # most Newton steps of one time step
    capped: wp.array(dtype=int)  # time steps that ended at the limit
    residual: wp.array(dtype=wp.float64)  # largest last Newton step [m]


@wp.struct
class StepClock:
    """Progress of a call; its time steps are halved again and again where one fails."""

    tick: wp.float64  # the shortest step [s]
    ticks: int  # of the call
    done: int
    size: int  # ticks of the next step, a power of two


@wp.func
def clock_of(h: wp.float64, count: int) -> StepClock:
    """Return the clock at the start of a call of `count` time steps of h [s]."""
    out = StepClock()
    out.size = int(STEP_PARTS_MAX)
    out.tick = h / wp.float64(out.size)
    out.ticks = count * out.size
    return out


@wp.func
def clock_after(clock: StepClock, taken: int) -> StepClock:
    """Return the clock after a step, or after a failed one, to be tried again in half the time."""
    out = clock
    if taken == 0:
        out.size = clock.size / 2
    else:
        out.done = clock.done + clock.size
        finest = int(STEP_PARTS_MAX)
        while out.size < finest and out.done % (2 * out.size) == 0:
            out.size = 2 * out.size
    return out


@wp.func
def is_nonsense(worlds: Worlds, b: int) -> int:
    """Return 1 if a command is no length: not finite, or not positive."""
    for i in range(worlds.command.shape[1]):
        if not (worlds.command[b, i] > wp.float64(0.0) and wp.isfinite(worlds.command[b, i])):
            return 1
    return 0


@wp.func
def turn_winches(plants: Plants, worlds: Worlds, b: int, row: int, h: wp.float64, left: wp.float64,
                 follow: int, lane: int, lanes: int):  # fmt: skip
    """Advance the lengths to the end of a time step.

    Args:
        plants: The robots.
        worlds: Their state.
        b: World.
        row: Its plant.
        h: Time step [s].
        left: Time to the end of the call, this step included [s].
        follow: True if the lengths themselves go straight to the command, without winches.
        lane: This thread among those of the world, each of which has its own cables.
        lanes: Number of these threads.
    """
    for i in range(lane, worlds.command.shape[1], lanes):
        worlds.winch_before[b, i] = worlds.winch[b, i]
        if follow == 1:
            state = worlds.winch[b, i]
            state.rate = (worlds.command[b, i] - state.length) / left
            state.length = state.length + h * state.rate
            state.wound = state.length + plants.winches[row, i].hysteresis * state.lag
            state.wound_rate = state.rate
            worlds.winch[b, i] = state
        else:
            worlds.winch[b, i] = winch_advance(
                plants.winches[row, i], worlds.winch[b, i], worlds.command[b, i], h
            )


@wp.func
def turn_back(worlds: Worlds, b: int, lane: int, lanes: int):
    """Undo the last `turn_winches`."""
    for i in range(lane, worlds.command.shape[1], lanes):
        worlds.winch[b, i] = worlds.winch_before[b, i]


@wp.func
def roughness(rough: int, impact: bool) -> int:
    """Return the steps to go until an impact is over, after a step with or without one."""
    if rough == STEPS_ALIKE:
        return STEPS_ALIKE
    if impact:
        return CALM_STEPS
    return wp.max(rough - 1, 0)


@wp.func
def is_lost(motion: BodyMotion, body: DynamicBody, home: wp.vec3d) -> bool:
    """Return true if a motion is not finite or too far away."""
    return not (
        wp.length(motion.center - home) < LOST_DISTANCE_LENGTHS * body.size
        and wp.length(motion.velocity) < wp.float64(1.0e4)
        and wp.length(motion.angular_velocity) < wp.float64(1.0e5)
        and wp.isfinite(motion.rotation[0, 0])
    )


@wp.func
def publish(plants: Plants, worlds: Worlds, b: int, row: int, lane: int, lanes: int):
    """Write what people read: pose, twist and acceleration of the platform origin, and lengths."""
    body = plants.bodies[row]
    motion = worlds.motion[b]
    v = origin_velocity(body, motion)
    w = motion.angular_velocity
    a = origin_acceleration(body, motion)
    alpha = motion.angular_acceleration
    worlds.position[b] = origin_of(body, motion)
    worlds.rotation[b] = motion.rotation
    worlds.twist[b] = vec6d(v[0], v[1], v[2], w[0], w[1], w[2])
    worlds.acceleration[b] = vec6d(a[0], a[1], a[2], alpha[0], alpha[1], alpha[2])
    for i in range(lane, worlds.winch.shape[1], lanes):
        worlds.unstrained_length[b, i] = worlds.winch[b, i].length
        worlds.wound_length[b, i] = worlds.winch[b, i].wound


@wp.func
def start_anchor(plants: Plants, worlds: Worlds, b: int, row: int, i: int, sliding: BodyMotion):
    """Store what a cable needs of its anchor point where a motion without a past begins.

    Args:
        plants: Robots.
        worlds: Worlds.
        b: World.
        row: Of its robot.
        i: Cable.
        sliding: The motion there, but with the velocities of what rubs before.
    """
    cable = plants.cables[row, i]
    body = plants.bodies[row]
    motion = worlds.motion[b]
    arm = motion.rotation * (cable.anchor_point - body.center_of_mass)
    worlds.anchor_velocity[b, i] = motion.velocity + wp.cross(motion.angular_velocity, arm)
    worlds.anchor_rate[b, i] = wp.vec3d()
    if rubs(cable):
        time = SLIDING_TIME * wp.sqrt(body.size / body.gravity)
        omega = sliding.angular_velocity
        velocity = sliding.velocity + wp.cross(omega, arm)
        worlds.bristles[b, i] = slid_bristles(
            cable, motion.center + arm, velocity, omega, body.size, time
        )


@wp.kernel
def place(plants: Plants, worlds: Worlds, which: wp.array(dtype=int),
          position: wp.array(dtype=wp.vec3d), rotation: wp.array(dtype=wp.mat33d),
          twist: wp.array(dtype=vec6d), sliding: wp.array(dtype=vec6d),
          unstrained_length: wp.array2d(dtype=wp.float64),
          tension: wp.array2d(dtype=wp.float64)):  # fmt: skip
    """Put some worlds where they shall start, winches at rest; one thread a row of `which`.

    What rubs has been sliding with the twist `sliding`.
    """
    k = wp.tid()
    b = which[k]
    row = wp.min(b, plants.bodies.shape[0] - 1)
    body = plants.bodies[row]
    v = wp.vec3d(twist[k][0], twist[k][1], twist[k][2])
    w = wp.vec3d(twist[k][3], twist[k][4], twist[k][5])
    motion = at_rest(body, position[k], rotation[k], v, w)
    v = wp.vec3d(sliding[k][0], sliding[k][1], sliding[k][2])
    w = wp.vec3d(sliding[k][3], sliding[k][4], sliding[k][5])
    before = at_rest(body, position[k], rotation[k], v, w)
    worlds.motion[b] = motion
    worlds.gusts[b] = Gusts()
    worlds.time[b] = wp.float64(0.0)
    worlds.last[b] = wp.float64(0.0)
    worlds.rough[b] = 0
    worlds.failed[b] = 0
    worlds.iterations[b] = 0
    worlds.capped[b] = 0
    worlds.residual[b] = wp.float64(0.0)
    for i in range(worlds.winch.shape[1]):
        worlds.winch[b, i] = resting(unstrained_length[k, i])
        start_anchor(plants, worlds, b, row, i, before)
        worlds.tension[b, i] = tension[k, i]
    publish(plants, worlds, b, row, 0, 1)
