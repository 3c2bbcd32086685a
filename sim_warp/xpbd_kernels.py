"""Chains of particles by extended position-based dynamics (XPBD), in float64 Warp.

The method of game engines and of the system that this toolkit rebuilds, for comparison: positions
are predicted, then each segment in turn pulls its two ends together (Gauss-Seidel), over and over,
within its compliance. Stiff cables behave as soft ones until iterations are many or steps small;
then it tends to what `particle_kernels` solves exactly.

References:
    Macklin, Müller, Chentanez, *XPBD: position-based simulation of compliant constrained
    dynamics*, 2016.
"""

import warp as wp

from carosac_toolkit.physics.cable.catenary_kernels import HALF, ONE, ZERO, density_of, inverse33
from carosac_toolkit.physics.cable.straight_line_kernels import straight_cable
from carosac_toolkit.physics.device_kernels import Cable
from carosac_toolkit.physics.motion.body_kernels import (
    BodyMotion,
    DynamicBody,
    blow,
    spin_drag,
    world_inertia,
)
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
    CableMesh,
    Chains,
    length_share,
    mesh_of,
    node_mass,
    run_strain,
    wrapped_arc,
)

wp.set_module_options({"enable_backward": False, "max_unroll": 1})


@wp.struct
class LoadedBody:
    """The platform with the half segments at its anchor points, within a time step."""

    center: wp.vec3d  # centre of mass of all that [m]
    lever: wp.vec3d  # from the platform's centre of mass to it, in P [m]
    rotation: wp.mat33d
    inverse_mass: wp.float64  # [1/kg]
    inverse_inertia: wp.mat33d  # in W [1/(kg m^2)]


@wp.func
def loaded_body(plants: Plants, worlds: Worlds, chains: Chains, b: int, row: int, body: DynamicBody,
                motion: BodyMotion) -> LoadedBody:  # fmt: skip
    """Combine platform and half segments into one rigid body."""
    mass = body.mass
    moment = wp.vec3d()
    inertia = world_inertia(body, motion.rotation)
    back = wp.transpose(motion.rotation)
    identity = wp.identity(n=3, dtype=wp.float64)
    for i in range(worlds.winch.shape[1]):
        cable = plants.cables[row, i]
        m = half_mass(cable, worlds.winch[b, i].length, chains.arc[b, i], body, chains.segments)
        arm = motion.rotation * (cable.anchor_point - body.center_of_mass)
        mass += m
        moment = moment + m * arm
        inertia = inertia + m * (wp.dot(arm, arm) * identity - wp.outer(arm, arm))
    shift = moment / mass
    inertia = inertia - mass * (wp.dot(shift, shift) * identity - wp.outer(shift, shift))
    out = LoadedBody()
    out.center = motion.center + shift
    out.lever = back * shift
    out.rotation = motion.rotation
    out.inverse_mass = ONE / mass
    out.inverse_inertia = inverse33(inertia)
    return out


@wp.func
def half_mass(cable: Cable, length: wp.float64, arc: wp.float64, body: DynamicBody,
              segments: int) -> wp.float64:  # fmt: skip
    """Return the mass of half a segment [kg]."""
    return HALF * density_of(cable, body.gravity) * (length - arc) / wp.float64(segments)


@wp.func
def predict_nodes(chains: Chains, b: int, s: int, n: int, body: DynamicBody, h: wp.float64):
    """Predict all nodes in free fall; `trial` keeps their positions before that [m]."""
    for i in range(n):
        for k in range(chains.segments - 1):
            v = chains.velocity[b, i, k]
            v = v + h * (wp.vec3d(ZERO, ZERO, -body.gravity) - body.cable_drag * v)
            chains.trial[s, i, k] = chains.position[b, i, k]
            chains.position[b, i, k] = chains.position[b, i, k] + h * v
        for k in range(chains.segments):
            chains.predicted[b, i, k] = ZERO  # the multiplier: minus tension times h^2


@wp.func
def project_segment(chains: Chains, cable: Cable, mesh: CableMesh, b: int, s: int, i: int, k: int,
                    platform: LoadedBody, start: LoadedBody, body: DynamicBody,
                    h: wp.float64) -> LoadedBody:  # fmt: skip
    """Project the constraint of one segment: pull its ends together within its compliance."""
    out = platform
    last = chains.segments - 1
    share = length_share(k, chains.segments)
    rest_length = share * mesh.mean_length
    if k == 0:
        rest_length = mesh.first_length + cable.run_length
    compliance = rest_length / cable.axial_stiffness / (h * h)
    damping = cable.axial_damping / cable.axial_stiffness / h
    arm = wp.vec3d()
    upper = wp.vec3d()
    upper_step = wp.vec3d()
    upper_inverse_mass = wp.float64(0.0)
    if k > 0:
        upper = chains.position[b, i, k - 1]
        upper_step = upper - chains.trial[s, i, k - 1]
        upper_inverse_mass = ONE / node_mass(mesh, k - 1)
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
        strain = run_strain(cable, mesh, body.gravity, unit)
        excess = span - mesh.first_length - cable.run_length * strain
        paid_out = h * mesh.first_rate
    else:
        d = lower - upper
        span = wp.length(d) + wp.float64(1.0e-12)
        unit = d / span
        excess = span - rest_length
        paid_out = h * share * mesh.mean_rate
    turn = wp.vec3d()
    if k == last:
        turn = platform.inverse_inertia * wp.cross(arm, unit)
        lower_inverse_mass = platform.inverse_mass + wp.dot(wp.cross(arm, unit), turn)
    else:
        lower_inverse_mass = ONE / node_mass(mesh, k)
    multiplier = chains.predicted[b, i, k]
    rate = wp.dot(unit, lower_step - upper_step) - paid_out
    change = -(excess + compliance * multiplier + damping * rate) / (
        (ONE + damping) * (lower_inverse_mass + upper_inverse_mass) + compliance
    )
    change = wp.min(multiplier + change, ZERO) - multiplier
    chains.predicted[b, i, k] = multiplier + change
    if k > 0:
        chains.position[b, i, k - 1] = upper - (change * upper_inverse_mass) * unit
    if k == last:
        out.center = platform.center + (change * platform.inverse_mass) * unit
        out.rotation = rotation_of(change * turn) * platform.rotation
    else:
        chains.position[b, i, k] = lower + (change * lower_inverse_mass) * unit
    return out


@wp.func
def rotation_vector(r: wp.mat33d) -> wp.vec3d:
    """Return the rotation vector of a small rotation."""
    sine = HALF * wp.vec3d(r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1])
    size = wp.length(sine)
    scale = ONE + size * size / wp.float64(6.0)
    if size > wp.float64(1.0e-3):
        scale = wp.asin(wp.min(size, ONE)) / size
    return scale * sine


@wp.func
def accept_nodes(plants: Plants, worlds: Worlds, chains: Chains, b: int, s: int, row: int,
                 h: wp.float64):  # fmt: skip
    """Derive velocities from positions and tensions from multipliers."""
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
              h: wp.float64, iterations: int):  # fmt: skip
    """Predict, project, derive velocities; the unstrained lengths are already those at the end."""
    body = plants.bodies[row]
    motion = worlds.motion[b]
    n = worlds.winch.shape[1]
    gusts = blow(plants.winds[row], worlds.gusts[b], worlds.time[b] + h, worlds.seed[b])
    start = loaded_body(plants, worlds, chains, b, row, body, motion)
    omega = motion.angular_velocity
    velocity = motion.velocity + wp.cross(omega, motion.rotation * start.lever)
    push = gusts.force - body.drag * motion.velocity
    # Wind and drag act on the platform's own centre of mass.
    moment = -spin_drag(body, motion.rotation, omega)
    moment = moment - wp.cross(motion.rotation * start.lever, push)
    spin = inverse33(start.inverse_inertia) * omega
    moment = moment - wp.cross(omega, spin)
    velocity = velocity + h * (start.inverse_mass * push - wp.vec3d(ZERO, ZERO, body.gravity))
    omega = omega + h * (start.inverse_inertia * moment)
    platform = start
    platform.center = start.center + h * velocity
    platform.rotation = rotation_of(h * omega) * start.rotation
    predict_nodes(chains, b, s, n, body, h)
    for _j in range(iterations):
        for i in range(n):
            winch = worlds.winch[b, i]
            cable = plants.cables[row, i]
            mesh = mesh_of(
                cable, winch.length, winch.rate, chains.arc[b, i], ZERO, body.gravity,
                chains.segments,
            )  # fmt: skip
            for k in range(chains.segments):
                platform = project_segment(
                    chains, cable, mesh, b, s, i, k, platform, start, body, h
                )
    after = motion
    after.rotation = orthonormal(platform.rotation)
    after.center = platform.center - after.rotation * start.lever
    after.angular_velocity = rotation_vector(platform.rotation * wp.transpose(start.rotation)) / h
    velocity = (platform.center - start.center) / h
    after.velocity = velocity - wp.cross(after.angular_velocity, after.rotation * start.lever)
    after.acceleration = (after.velocity - motion.velocity) / h
    after.angular_acceleration = (after.angular_velocity - motion.angular_velocity) / h
    worlds.iterations[b] = iterations
    if is_lost(after, body, plants.cables[row, 0].exit_point):
        worlds.failed[b] = 1
    else:
        worlds.motion[b] = after
        worlds.gusts[b] = gusts
        worlds.time[b] = worlds.time[b] + h
        accept_nodes(plants, worlds, chains, b, s, row, h)


@wp.kernel
def advance(plants: Plants, worlds: Worlds, chains: Chains, iterations: int, follow: int,
            count: int, h: wp.float64):  # fmt: skip
    """Advance each world by `count` time steps of h; one thread a world."""
    b = wp.tid()
    s = wp.min(b, chains.trial.shape[0] - 1)
    row = wp.min(b, plants.bodies.shape[0] - 1)
    worlds.failed[b] = wp.max(worlds.failed[b], is_nonsense(worlds, b))
    left = count
    while left > 0 and worlds.failed[b] == 0:
        turn_winches(plants, worlds, b, row, h, h * wp.float64(left), follow, 0, 1)
        time_step(plants, worlds, chains, b, s, row, h, iterations)
        if worlds.failed[b] == 1:
            turn_back(worlds, b, 0, 1)
        left -= 1
    publish(plants, worlds, b, row, 0, 1)
