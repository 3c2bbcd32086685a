"""A rigid body in time, in float64 Warp: implicit steps of any size, in momentum form.

Generalised-alpha method of Wood, Bossak and Zienkiewicz: forces count at the end of the step only,

    (1 - alpha) a' + alpha a = force' / mass,
    x' = x + h v + h^2 ((1/2 - beta) a + beta a'),    v' = v + h ((1 - gamma) a + gamma a'),

with gamma = 1/2 - alpha and beta = (1 - alpha)^2 / 4: second order, unconditionally stable, and a
share (1 + alpha) / (1 - alpha) of motions that are much faster than the step is left after each.
Its frequencies are 2.5 times as accurate as those of BDF2 and its damping of slow motions is an
eighth of it. `a` is an algorithmic acceleration: that of a time alpha h away from the end of the
step. Where that memory is worth nothing, a step of the implicit Euler method has none: the first
one, and one of more than twice or less than half the size of the last. A cable that falls slack or
snaps taut leaves `a` far off, which would give energy back that was never there; in the few steps
after it less is left of fast motions, or Euler steps, which never add energy to springs, are taken.

The unknowns are the velocities at the end. Rotations go by the rotation vector of the step, and
the angular momentum about the centre of mass by the moment: no gyroscopic term is needed.

References:
    Wood, Bossak, Zienkiewicz, *An alpha modification of Newmark's method*, 1980.
    Brüls, Cardona, *On the use of Lie group time integrators in multibody dynamics*, 2010.
"""

import warp as wp

from carosac_toolkit.physics.cable.catenary_kernels import HALF, ONE, ZERO, inverse33
from carosac_toolkit.physics.rest.platform_kernels import lever_terms, orthonormal, rotation_of

wp.set_module_options({"enable_backward": False, "max_unroll": 1})


@wp.struct
class DynamicBody:
    """The platform with its payloads."""

    mass: wp.float64  # [kg]
    center_of_mass: wp.vec3d  # in P [m]
    inertia: wp.mat33d  # about the centre of mass, axes of P [kg m^2]
    drag: wp.float64  # [N s/m], on the velocity of the centre of mass
    angular_drag: wp.float64  # [N m s/rad]
    angular_drag_beyond: wp.vec3d  # what is more about each axis of P
    cable_drag: wp.float64  # per mass of cable [1/s]
    gravity: wp.float64  # [m/s^2], along -z of W
    arm: wp.float64  # typical lever of an anchor point [m]
    size: wp.float64  # typical cable length [m]


FAST_MOTION_SHARE = wp.constant(
    wp.float64(0.7)
)  # share of very fast motions that is left after a step
FAST_MOTION_SHARE_ROUGH = wp.constant(
    wp.float64(0.2)
)  # the same while particles fall slack and snap taut
STEP_RATIO_MAX = wp.constant(wp.float64(2.0))  # a larger ratio of two steps is a new start


@wp.struct
class BodyMotion:
    """Pose, velocities and rates of the body, all in W."""

    center: wp.vec3d  # centre of mass [m]
    rotation: wp.mat33d  # from P to W
    velocity: wp.vec3d  # of the centre of mass [m/s]
    angular_velocity: wp.vec3d  # [rad/s]
    spin: wp.vec3d  # angular momentum about the centre of mass [N m s]
    velocity_rate: wp.vec3d  # algorithmic [m/s^2]
    angular_rate: wp.vec3d  # algorithmic [rad/s^2]
    spin_rate: wp.vec3d  # algorithmic [N m]
    acceleration: wp.vec3d  # of the centre of mass [m/s^2]
    angular_acceleration: wp.vec3d  # [rad/s^2]


@wp.struct
class Scheme:
    """Coefficients of one step."""

    h: wp.float64  # [s]
    alpha: wp.float64
    gamma: wp.float64
    coast: wp.float64  # position per rate at the start [s^2]
    reach: wp.float64  # position per velocity at the end [s]
    stiff: wp.float64  # inertial force per mass and position [1/s^2]


@wp.struct
class System:
    """Force and moment, and the symmetric matrix of a Newton step, in 3x3 blocks."""

    force: wp.vec3d  # [N]
    moment: wp.vec3d  # about the centre of mass [N m]
    tt: wp.mat33d  # translation, translation [N/m]
    tr: wp.mat33d  # translation, rotation [N]
    rr: wp.mat33d  # rotation, rotation [N m]


@wp.struct
class Newton:
    """A step of the body."""

    move: wp.vec3d  # [m]
    turn: wp.vec3d  # rotation vector [rad]


@wp.func
def scheme_of(h: wp.float64, last: wp.float64, forget: bool, left: wp.float64) -> Scheme:
    """Return the coefficients of a step of h [s] after one of `last`, 0 for none.

    It is an implicit Euler step after a jump in size and to `forget` what was before; of motions
    that are much faster than another step a share `left` is left.
    """
    slack = STEP_RATIO_MAX * wp.float64(1.0 + 1.0e-6)
    out = Scheme()
    out.h = h
    if forget or h > slack * last or last > slack * h:
        out.gamma = ONE
        out.reach = h
        out.stiff = ONE / (h * h)
    else:
        out.alpha = (left - ONE) / (left + ONE)
        out.gamma = HALF - out.alpha
        share = ONE - out.alpha
        beta = wp.float64(0.25) * share * share
        out.reach = h * beta / out.gamma
        out.coast = h * h * (HALF - beta) - out.reach * h * (ONE - out.gamma)
        out.stiff = share / (beta * h * h)
    return out


@wp.func
def increment(s: Scheme, v: wp.vec3d, a: wp.vec3d, v1: wp.vec3d) -> wp.vec3d:
    """Return x' - x from velocity and rate at the start and velocity at the end."""
    return (s.h - s.reach) * v + s.coast * a + s.reach * v1


@wp.func
def rate_after(s: Scheme, v: wp.vec3d, a: wp.vec3d, v1: wp.vec3d) -> wp.vec3d:
    """Return the algorithmic rate a' at the end."""
    return ((v1 - v) / s.h - (ONE - s.gamma) * a) / s.gamma


@wp.func
def rate_felt(s: Scheme, v: wp.vec3d, a: wp.vec3d, v1: wp.vec3d) -> wp.vec3d:
    """Return the rate that balances the forces at the end, (1 - alpha) a' + alpha a."""
    return (ONE - s.alpha) * rate_after(s, v, a, v1) + s.alpha * a


@wp.func
def world_inertia(body: DynamicBody, rotation: wp.mat33d) -> wp.mat33d:
    """Return the inertia about the centre of mass, axes of W [kg m^2]."""
    return rotation * body.inertia * wp.transpose(rotation)


@wp.func
def spin_drag(body: DynamicBody, rotation: wp.mat33d, omega: wp.vec3d) -> wp.vec3d:
    """Return the moment of the air against an angular velocity, both in W [N m]."""
    about = wp.transpose(rotation) * omega
    beyond = rotation * wp.cw_mul(body.angular_drag_beyond, about)
    return body.angular_drag * omega + beyond


@wp.func
def moved(start: BodyMotion, scheme: Scheme, velocity: wp.vec3d, omega: wp.vec3d) -> BodyMotion:
    """Return the motion at the end of a step for trial velocities; rates are those at its start."""
    out = start
    out.velocity = velocity
    out.angular_velocity = omega
    out.center = start.center + increment(scheme, start.velocity, start.velocity_rate, velocity)
    turn = increment(scheme, start.angular_velocity, start.angular_rate, omega)
    out.rotation = rotation_of(turn) * start.rotation
    return out


@wp.func
def inertial_system(body: DynamicBody, start: BodyMotion, trial: BodyMotion, scheme: Scheme,
                    wind: wp.vec3d) -> System:  # fmt: skip
    """Return weight, wind, drag and inertia of the body at a trial motion."""
    out = System()
    jw = world_inertia(body, trial.rotation)
    v = trial.velocity
    omega = trial.angular_velocity
    felt = rate_felt(scheme, start.velocity, start.velocity_rate, v)
    spin_felt = rate_felt(scheme, start.spin, start.spin_rate, jw * omega)
    weight = wp.vec3d(ZERO, ZERO, -body.mass * body.gravity)
    out.force = weight + wind - body.drag * v - body.mass * felt
    out.moment = -spin_drag(body, trial.rotation, omega) - spin_felt
    unity = wp.identity(n=3, dtype=wp.float64)
    out.tt = (body.mass * scheme.stiff + body.drag / scheme.reach) * unity
    out.rr = scheme.stiff * jw + (body.angular_drag / scheme.reach) * unity
    beyond = wp.diag(body.angular_drag_beyond / scheme.reach)
    out.rr = out.rr + trial.rotation * beyond * wp.transpose(trial.rotation)
    return out


@wp.func
def attach(system: System, arm: wp.vec3d, force: wp.vec3d, k: wp.mat33d) -> System:
    """Add a force at a lever arm whose point of attack has the stiffness k = -d force / d point."""
    out = system
    moment, kx, xkx, turn = lever_terms(arm, force, k)
    out.force = system.force + force
    out.moment = system.moment + moment
    out.tt = system.tt + k
    out.tr = system.tr - kx
    out.rr = system.rr - xkx - HALF * (turn + wp.transpose(turn))
    return out


@wp.func
def solve_system(s: System) -> Newton:
    """Return the step that balances force and moment to first order, by blocks."""
    a = inverse33(s.tt)
    ab = a * s.tr
    schur = s.rr - wp.transpose(s.tr) * ab
    out = Newton()
    af = a * s.force
    out.turn = inverse33(HALF * (schur + wp.transpose(schur))) * (
        s.moment - wp.transpose(s.tr) * af
    )
    out.move = af - ab * out.turn
    return out


@wp.func
def finish(body: DynamicBody, start: BodyMotion, trial: BodyMotion, scheme: Scheme) -> BodyMotion:
    """Accept a trial motion as the end of a step."""
    out = trial
    v = trial.velocity
    omega = trial.angular_velocity
    out.rotation = orthonormal(trial.rotation)
    jw = world_inertia(body, out.rotation)
    out.spin = jw * omega
    out.velocity_rate = rate_after(scheme, start.velocity, start.velocity_rate, v)
    out.angular_rate = rate_after(scheme, start.angular_velocity, start.angular_rate, omega)
    out.spin_rate = rate_after(scheme, start.spin, start.spin_rate, out.spin)
    out.acceleration = rate_felt(scheme, start.velocity, start.velocity_rate, v)
    moment = rate_felt(scheme, start.spin, start.spin_rate, out.spin)
    # d(J omega)/dt = J alpha + omega x J omega in W.
    out.angular_acceleration = inverse33(jw) * (moment - wp.cross(omega, out.spin))
    return out


@wp.func
def at_rest(body: DynamicBody, position: wp.vec3d, rotation: wp.mat33d, velocity: wp.vec3d,
            omega: wp.vec3d) -> BodyMotion:  # fmt: skip
    """Return a motion without a past, from pose and twist at the platform origin."""
    out = BodyMotion()
    lever = rotation * body.center_of_mass
    out.center = position + lever
    out.rotation = rotation
    out.velocity = velocity + wp.cross(omega, lever)
    out.angular_velocity = omega
    out.spin = world_inertia(body, rotation) * omega
    return out


@wp.func
def origin_of(body: DynamicBody, motion: BodyMotion) -> wp.vec3d:
    """Return the platform origin in W [m]."""
    return motion.center - motion.rotation * body.center_of_mass


@wp.func
def origin_velocity(body: DynamicBody, motion: BodyMotion) -> wp.vec3d:
    """Return the velocity of the platform origin in W [m/s]."""
    return motion.velocity - wp.cross(
        motion.angular_velocity, motion.rotation * body.center_of_mass
    )


@wp.func
def origin_acceleration(body: DynamicBody, motion: BodyMotion) -> wp.vec3d:
    """Return the acceleration of the platform origin in W [m/s^2]."""
    lever = motion.rotation * body.center_of_mass
    omega = motion.angular_velocity
    return (
        motion.acceleration
        - wp.cross(motion.angular_acceleration, lever)
        - wp.cross(omega, wp.cross(omega, lever))
    )


@wp.struct
class Wind:
    """A gusty force on the platform: Ornstein-Uhlenbeck, horizontal."""

    deviation: wp.float64  # standard deviation per axis [N]
    time: wp.float64  # correlation time [s]
    interval: wp.float64  # between two draws [s]


@wp.struct
class Gusts:
    """Wind force on one platform [N], interpolated between draws at equal intervals."""

    force: wp.vec3d  # at the end of the last step
    before: wp.vec3d
    after: wp.vec3d
    count: int  # of instants drawn so far; `after` is the force at (count - 1) intervals


@wp.func
def draw_gust(wind: Wind, force: wp.vec3d, keep: wp.float64, seed: int, count: int) -> wp.vec3d:
    """Draw a force that keeps a share `keep` of an earlier one; `seed`, `count` name the draw."""
    state = wp.rand_init(seed, count)
    spread = wind.deviation * wp.sqrt(ONE - keep * keep)
    gx = wp.float64(wp.randn(state))
    gy = wp.float64(wp.randn(state))
    return wp.vec3d(keep * force[0] + spread * gx, keep * force[1] + spread * gy, ZERO)


@wp.func
def blow(wind: Wind, gusts: Gusts, time: wp.float64, seed: int) -> Gusts:
    """Return the wind at a later time [s]; its own grid of draws is independent of the steps."""
    out = gusts
    if wind.deviation > ZERO:
        if out.count == 0:
            out.after = draw_gust(wind, out.after, ZERO, seed, 0)  # of the stationary distribution
            out.count = 1
        keep = wp.exp(-wind.interval / wind.time)
        while time > wp.float64(out.count - 1) * wind.interval:
            out.before = out.after
            out.after = draw_gust(wind, out.before, keep, seed, out.count)
            out.count += 1
        share = time / wind.interval - wp.float64(out.count - 2)
        out.force = out.before + share * (out.after - out.before)
    return out
