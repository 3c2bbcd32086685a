"""Chains of particles by extended position-based dynamics (XPBD), in float64 Warp.

The method of game engines and of the system that this toolkit rebuilds, for comparison: positions
are predicted, then each segment in turn pulls its two ends together (Gauss-Seidel), over and over,
within its compliance. It takes stiff cables for soft ones until iterations are many or steps small;
then it tends to what `particle_kernels` solves exactly.

References:
    Macklin, Müller, Chentanez, *XPBD: position-based simulation of compliant constrained
    dynamics*, 2016.
"""

import warp as wp

from carosac_toolkit.physics.cable.catenary_kernels import (
    HALF,
    ONE,
    ZERO,
    Cable,
    density_of,
    inverse33,
)
from carosac_toolkit.physics.cable.straight_line_kernels import straight_cable
from carosac_toolkit.physics.motion.body_kernels import BodyMotion, DynamicBody, blow, world_inertia
from carosac_toolkit.physics.motion.world_kernels import (
    Plants,
    Worlds,
    is_lost,
    is_nonsense,
    publish,
    turn_back,
    turn_winches,
)
from carosac_toolkit.physics.rest.platform_kernels import orthonormal, rotation_of
from sim_warp.particle_kernels import (
    Chains,
    Feed,
    length_share,
    node_mass,
    run_strain,
    share_out,
    wrapped_arc,
)

wp.set_module_options({"enable_backward": False, "max_unroll": 1})


@wp.struct
class Body:
    """The platform with the half segments at its anchor points, in the course of a time step."""

    center: wp.vec3d  # centre of mass of all that [m]
    lever: wp.vec3d  # from the platform's centre of mass to it, in P [m]
    rotation: wp.mat33d
    mobility: wp.float64  # 1 / mass [1/kg]
    turning: wp.mat33d  # inverse inertia, in W [1/(kg m^2)]


@wp.func
def whole_body(plants: Plants, worlds: Worlds, chains: Chains, b: int, row: int, body: DynamicBody,
               motion: BodyMotion) -> Body:  # fmt: skip
    """Platform and half segments as one rigid body."""
    mass = body.mass
    moment = wp.vec3d()
    inertia = world_inertia(body, motion.rotation)
    back = wp.transpose(motion.rotation)
    unity = wp.identity(n=3, dtype=wp.float64)
    for i in range(worlds.winch.shape[1]):
        cable = plants.cables[row, i]
        m = half_mass(cable, worlds.winch[b, i].length, chains.arc[b, i], body, chains.segments)
        arm = motion.rotation * (cable.anchor_point - body.center_of_mass)
        mass += m
        moment = moment + m * arm
        inertia = inertia + m * (wp.dot(arm, arm) * unity - wp.outer(arm, arm))
    shift = moment / mass
    inertia = inertia - mass * (wp.dot(shift, shift) * unity - wp.outer(shift, shift))
    out = Body()
    out.center = motion.center + shift
    out.lever = back * shift
    out.rotation = motion.rotation
    out.mobility = ONE / mass
    out.turning = inverse33(inertia)
    return out


@wp.func
def half_mass(cable: Cable, length: wp.float64, arc: wp.float64, body: DynamicBody,
              segments: int) -> wp.float64:  # fmt: skip
    """Mass of half a segment [kg]."""
    return HALF * density_of(cable, body.gravity) * (length - arc) / wp.float64(segments)


@wp.func
def predict_nodes(chains: Chains, b: int, s: int, n: int, gravity: wp.float64, h: wp.float64):
    """Free flight of all nodes; what they leave is kept in `trial`."""
    for i in range(n):
        for k in range(chains.segments - 1):
            v = chains.velocity[b, i, k]
            v = v + h * (wp.vec3d(ZERO, ZERO, -gravity) - chains.drag * v)
            chains.trial[s, i, k] = chains.position[b, i, k]
            chains.position[b, i, k] = chains.position[b, i, k] + h * v
        for k in range(chains.segments):
            chains.predicted[b, i, k] = ZERO  # the multiplier: minus tension times h^2


@wp.func
def pull_segment(chains: Chains, cable: Cable, feed: Feed, b: int, s: int, i: int, k: int,
                 platform: Body, start: Body, body: DynamicBody,
                 h: wp.float64) -> Body:  # fmt: skip
    """Let one segment pull its ends together within its compliance."""
    out = platform
    last = chains.segments - 1
    share = length_share(k, chains.segments)
    rest = share * feed.other
    if k == 0:
        rest = feed.first + cable.run_length
    compliance = rest / cable.axial_stiffness / (h * h)
    slip = cable.axial_damping / cable.axial_stiffness / h
    arm = wp.vec3d()
    upper = wp.vec3d()
    upper_step = wp.vec3d()
    upper_mobility = wp.float64(0.0)
    if k > 0:
        upper = chains.position[b, i, k - 1]
        upper_step = upper - chains.trial[s, i, k - 1]
        upper_mobility = ONE / node_mass(feed, k - 1)
    if k == last:
        offset = cable.anchor_point - body.center_of_mass - platform.lever
        arm = platform.rotation * offset
        lower = platform.center + arm
        lower_step = lower - start.center - start.rotation * offset
    else:
        lower = chains.position[b, i, k]
        lower_step = lower - chains.trial[s, i, k]
    if k == 0:
        span, _wrap, unit, _bend, _valid = straight_cable(
            lower - cable.exit_point, cable.pulley_radius, cable.swivel_axis
        )
        more = run_strain(cable, feed, body.gravity, unit)
        excess = span - feed.first - cable.run_length * more
        paid = h * feed.first_rate
    else:
        d = lower - upper
        span = wp.length(d) + wp.float64(1.0e-12)
        unit = d / span
        excess = span - rest
        paid = h * share * feed.other_rate
    turn = wp.vec3d()
    if k == last:
        turn = platform.turning * wp.cross(arm, unit)
        lower_mobility = platform.mobility + wp.dot(wp.cross(arm, unit), turn)
    else:
        lower_mobility = ONE / node_mass(feed, k)
    multiplier = chains.predicted[b, i, k]
    rate = wp.dot(unit, lower_step - upper_step) - paid
    change = -(excess + compliance * multiplier + slip * rate) / (
        (ONE + slip) * (lower_mobility + upper_mobility) + compliance
    )
    change = wp.min(multiplier + change, ZERO) - multiplier
    chains.predicted[b, i, k] = multiplier + change
    if k > 0:
        chains.position[b, i, k - 1] = upper - (change * upper_mobility) * unit
    if k == last:
        out.center = platform.center + (change * platform.mobility) * unit
        out.rotation = rotation_of(change * turn) * platform.rotation
    else:
        chains.position[b, i, k] = lower + (change * lower_mobility) * unit
    return out


@wp.func
def rotation_vector(r: wp.mat33d) -> wp.vec3d:
    """Rotation vector of a small rotation."""
    sine = HALF * wp.vec3d(r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1])
    size = wp.length(sine)
    scale = ONE + size * size / wp.float64(6.0)
    if size > wp.float64(1.0e-3):
        scale = wp.asin(wp.min(size, ONE)) / size
    return scale * sine


@wp.func
def keep_nodes(plants: Plants, worlds: Worlds, chains: Chains, b: int, s: int, row: int,
               h: wp.float64):  # fmt: skip
    """Velocities from positions; multipliers to tensions."""
    body = plants.bodies[row]
    motion = worlds.motion[b]
    for i in range(worlds.winch.shape[1]):
        cable = plants.cables[row, i]
        last = chains.segments - 1
        for k in range(last):
            moved = chains.position[b, i, k] - chains.trial[s, i, k]
            chains.velocity[b, i, k] = moved / h
        for k in range(chains.segments):
            chains.predicted[b, i, k] = -chains.predicted[b, i, k] / (h * h)
        arm = motion.rotation * (cable.anchor_point - body.center_of_mass)
        worlds.anchor_velocity[b, i] = motion.velocity + wp.cross(motion.angular_velocity, arm)
        mass = half_mass(cable, worlds.winch[b, i].length, chains.arc[b, i], body, chains.segments)
        unit = wp.normalize(motion.center + arm - chains.position[b, i, last - 1])
        end = -chains.predicted[b, i, last] * unit - wp.vec3d(ZERO, ZERO, mass * body.gravity)
        worlds.tension[b, i] = wp.length(end)
        chains.arc[b, i] = wrapped_arc(cable, chains.position[b, i, 0])


@wp.func
def time_step(plants: Plants, worlds: Worlds, chains: Chains, b: int, s: int, row: int,
              h: wp.float64, rounds: int):  # fmt: skip
    """Predict, project, derive velocities; lengths are those at the end already."""
    body = plants.bodies[row]
    motion = worlds.motion[b]
    n = worlds.winch.shape[1]
    gusts = blow(plants.winds[row], worlds.gusts[b], worlds.time[b] + h, worlds.seed[b])
    start = whole_body(plants, worlds, chains, b, row, body, motion)
    omega = motion.angular_velocity
    velocity = motion.velocity + wp.cross(omega, motion.rotation * start.lever)
    push = gusts.force - body.drag * motion.velocity
    # Wind and drag act on the platform's own centre of mass.
    moment = -body.angular_drag * omega - wp.cross(motion.rotation * start.lever, push)
    spin = inverse33(start.turning) * omega
    moment = moment - wp.cross(omega, spin)
    velocity = velocity + h * (start.mobility * push - wp.vec3d(ZERO, ZERO, body.gravity))
    omega = omega + h * (start.turning * moment)
    platform = start
    platform.center = start.center + h * velocity
    platform.rotation = rotation_of(h * omega) * start.rotation
    predict_nodes(chains, b, s, n, body.gravity, h)
    for _j in range(rounds):
        for i in range(n):
            winch = worlds.winch[b, i]
            cable = plants.cables[row, i]
            feed = share_out(
                cable, winch.length, winch.rate, chains.arc[b, i], ZERO, body.gravity,
                chains.segments,
            )  # fmt: skip
            for k in range(chains.segments):
                platform = pull_segment(chains, cable, feed, b, s, i, k, platform, start, body, h)
    after = motion
    after.rotation = orthonormal(platform.rotation)
    after.center = platform.center - after.rotation * start.lever
    after.angular_velocity = rotation_vector(platform.rotation * wp.transpose(start.rotation)) / h
    velocity = (platform.center - start.center) / h
    after.velocity = velocity - wp.cross(after.angular_velocity, after.rotation * start.lever)
    after.acceleration = (after.velocity - motion.velocity) / h
    after.angular_acceleration = (after.angular_velocity - motion.angular_velocity) / h
    worlds.iterations[b] = rounds
    if is_lost(after, body, plants.cables[row, 0].exit_point):
        worlds.failed[b] = 1
    else:
        worlds.motion[b] = after
        worlds.gusts[b] = gusts
        worlds.time[b] = worlds.time[b] + h
        keep_nodes(plants, worlds, chains, b, s, row, h)


@wp.kernel
def advance(plants: Plants, worlds: Worlds, chains: Chains, rounds: int, follow: int, count: int,
            h: wp.float64):  # fmt: skip
    """Advance each world by `count` time steps of h; one thread a world."""
    b = wp.tid()
    s = wp.min(b, chains.trial.shape[0] - 1)
    row = wp.min(b, plants.bodies.shape[0] - 1)
    worlds.failed[b] = wp.max(worlds.failed[b], is_nonsense(worlds, b))
    left = count
    while left > 0 and worlds.failed[b] == 0:
        turn_winches(plants, worlds, b, row, h, h * wp.float64(left), follow, 0, 1)
        time_step(plants, worlds, chains, b, s, row, h, rounds)
        if worlds.failed[b] == 1:
            turn_back(worlds, b, 0, 1)
        left -= 1
    publish(plants, worlds, b, row, 0, 1)
