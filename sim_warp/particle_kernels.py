"""Cables as chains of particles, hung between winches and a rigid platform, in float64 Warp.

A cable of free unstrained length L has N segments, about l = L / N long (`length_share`), and N - 1
nodes of equal mass between its tangent point and its anchor point; half of that is at each of its
ends. A segment pulls with

    T = EA (|d| - l) / l + D d(|d| / l)/dt,     T >= 0,

and the first one, which also stretches the run to the winch and wraps the pulley, with the length
along the pulley instead of |d|. Nodes slide along the material as the winch turns, so that the
segments keep their shares.

A time step is one implicit step of platform and nodes together (`body_kernels`), by Newton. Each
chain is a block-tridiagonal matrix: one sweep from the pulley to the anchor point eliminates its
nodes exactly and leaves a 3x3 stiffness and a force at the anchor point, as from any other cable;
after the platform's 6x6 solve one sweep back moves the nodes. Axial forces are unknowns beside the
positions: the stiffness of a taut string across itself uses the tension that the last linear solve
has predicted, not the one that the stretched geometry gives, which far from the solution is wild.
The active set are the segments that pull: one leaves it while its predicted tension and its stretch
say that it is slack.
"""

import warp as wp

from carosac_toolkit.physics.cable.catenary_kernels import HALF, ONE, ZERO, density_of
from carosac_toolkit.physics.cable.straight_line_kernels import straight_cable
from carosac_toolkit.physics.device_kernels import Cable
from carosac_toolkit.physics.motion.body_kernels import (
    FAST_MOTION_SHARE,
    FAST_MOTION_SHARE_ROUGH,
    BodyMotion,
    DynamicBody,
    Gusts,
    Scheme,
    System,
    attach,
    blow,
    finish,
    increment,
    inertial_system,
    moved,
    rate_after,
    rate_felt,
    scheme_of,
    solve_system,
)
from carosac_toolkit.physics.motion.capstan_kernels import (
    Run,
    capstan_exponent,
    grips,
    stretched,
)
from carosac_toolkit.physics.motion.friction_kernels import Bristles, rub, rubs, turn_since
from carosac_toolkit.physics.motion.world_kernels import (
    NEWTON_STEP_MIN,
    NEWTON_STEPS_MAX,
    Plants,
    Worlds,
    clock_after,
    clock_of,
    is_lost,
    is_nonsense,
    publish,
    roughness,
    turn_back,
    turn_winches,
)

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

# Weights of the end-corrected midpoint rule, from the ends inwards.
MIDPOINT_WEIGHT_0 = wp.constant(wp.float64(13.0 / 12.0))
MIDPOINT_WEIGHT_1 = wp.constant(wp.float64(7.0 / 8.0))
MIDPOINT_WEIGHT_2 = wp.constant(wp.float64(25.0 / 24.0))
NODE_NEWTON_STEP_MIN = wp.constant(
    wp.float64(1.0e-7)
)  # of the typical length: a smaller step of all nodes is the last


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    const unsigned first = (threadIdx.x & 31u) & ~(unsigned(lanes) - 1u);
    const unsigned mask = lanes == 32 ? 0xffffffffu : ((1u << lanes) - 1u) << first;
    for (int offset = lanes / 2; offset > 0; offset >>= 1)
        value += __shfl_xor_sync(mask, value, offset, lanes);
#endif
    return value;
""")
def lane_sum(value: wp.float64, lanes: int) -> wp.float64:
    """Return the sum over the threads of a world, whose number is a power of two.

    It has the same bits in all of them.
    """
    ...


@wp.func
def vector_sum(v: wp.vec3d, lanes: int) -> wp.vec3d:
    """Return `lane_sum` of each entry."""
    return wp.vec3d(lane_sum(v[0], lanes), lane_sum(v[1], lanes), lane_sum(v[2], lanes))


@wp.func
def matrix_sum(m: wp.mat33d, lanes: int) -> wp.mat33d:
    """Return `lane_sum` of each entry."""
    return wp.matrix_from_rows(
        vector_sum(m[0], lanes), vector_sum(m[1], lanes), vector_sum(m[2], lanes)
    )


@wp.struct
class Lane:
    """One of the `count` threads of a world: cables `index`, `index + count`, ...; one on a CPU."""

    index: int
    count: int


@wp.struct
class WorldState:
    """State of one world within a call, the same in all of its threads."""

    motion: BodyMotion
    gusts: Gusts
    last: wp.float64  # size of the last step [s]
    rough: int  # steps to go since the active set has changed
    failed: int
    time: wp.float64  # [s]
    iterations: int  # most Newton steps of one time step
    capped: int  # time steps that ended at the limit of Newton steps
    residual: wp.float64  # largest last Newton step [m]
    accepted: int  # 1 if the last time step was accepted


@wp.struct
class Chains:
    """Nodes and segments of B worlds of n cables; index k of a node is that of the segment above.

    Scratch arrays have one row where worlds are computed one after the other.
    """

    position: wp.array3d(dtype=wp.vec3d)  # of nodes [m], (B, n, N - 1)
    velocity: wp.array3d(dtype=wp.vec3d)  # [m/s]
    rate: wp.array3d(dtype=wp.vec3d)  # algorithmic acceleration [m/s^2]
    predicted: wp.array3d(dtype=wp.float64)  # tension of segments [N], (B, n, N)
    slack: wp.array3d(dtype=wp.uint8)  # 1 where a segment is not in the active set, (B, n, N)
    arc: wp.array2d(dtype=wp.float64)  # wrapped on the pulley [m], (B, n)
    trial: wp.array3d(dtype=wp.vec3d)  # scratch: velocity at the end of the step [m/s]
    coupling: wp.array3d(dtype=wp.mat33d)  # scratch: motion of a node per motion of the next
    shift: wp.array3d(dtype=wp.vec3d)  # scratch: motion of a node with the next one fixed [m]
    tension_gradient: wp.array3d(dtype=wp.vec3d)  # scratch: by the motion of the lower end [N/m]
    trial_tension: wp.array3d(dtype=wp.float64)  # scratch: at the trial positions [N]
    end_load: wp.array2d(dtype=wp.vec3d)  # scratch: weight less inertia of the last half segment
    end_unit: wp.array2d(dtype=wp.vec3d)  # scratch: direction of the last segment
    bristles: wp.array2d(dtype=Bristles)  # scratch: at the end of the step
    segments: int  # N


@wp.struct
class Segment:
    """One segment at trial positions."""

    unit: wp.vec3d  # from its upper to its lower end
    tension: wp.float64  # [N]
    axial: wp.float64  # stiffness along it within a time step [N/m]
    across: wp.mat33d  # stiffness across it [N/m]
    run: Run  # of the first segment


@wp.struct
class CableMesh:
    """Unstrained lengths of the segments of a cable, their rates and masses."""

    first_length: wp.float64  # datum to the first node [m]
    mean_length: wp.float64  # over all segments, without the arc on the pulley [m]
    first_rate: wp.float64  # [m/s]
    mean_rate: wp.float64  # [m/s]
    first_mass: wp.float64  # that hangs in the first segment [kg]
    mean_mass: wp.float64  # [kg]


@wp.struct
class AnchorLoad:
    """Load of a chain on its anchor point, with its nodes eliminated."""

    force: wp.vec3d  # [N]
    stiffness: wp.mat33d  # [N/m]
    run: Run


@wp.func
def inverse_spd(m: wp.mat33d) -> wp.mat33d:
    """Invert a symmetric positive definite matrix."""
    c00 = m[1, 1] * m[2, 2] - m[1, 2] * m[1, 2]
    c01 = m[0, 2] * m[1, 2] - m[0, 1] * m[2, 2]
    c02 = m[0, 1] * m[1, 2] - m[0, 2] * m[1, 1]
    s = ONE / (m[0, 0] * c00 + m[0, 1] * c01 + m[0, 2] * c02)
    i00 = s * c00
    i01 = s * c01
    i02 = s * c02
    i11 = s * (m[0, 0] * m[2, 2] - m[0, 2] * m[0, 2])
    i12 = s * (m[0, 1] * m[0, 2] - m[0, 0] * m[1, 2])
    i22 = s * (m[0, 0] * m[1, 1] - m[0, 1] * m[0, 1])
    return wp.mat33d(i00, i01, i02, i01, i11, i12, i02, i12, i22)


@wp.func
def length_share(k: int, segments: int) -> wp.float64:
    """Return the unstrained length of a segment over the mean: chains then hang as catenaries do.

    A chain of equal loads sums up, segment by segment, what a catenary integrates: the midpoint
    rule. With these weights near the ends it has fourth order instead of second.
    """
    end = wp.min(k, segments - 1 - k)
    share = wp.float64(1.0)
    if segments >= 6:
        if end == 0:
            share = MIDPOINT_WEIGHT_0
        if end == 1:
            share = MIDPOINT_WEIGHT_1
        if end == 2:
            share = MIDPOINT_WEIGHT_2
    return share


@wp.func
def mesh_of(cable: Cable, length: wp.float64, rate: wp.float64, arc: wp.float64,
            tension: wp.float64, gravity: wp.float64, segments: int) -> CableMesh:  # fmt: skip
    """Divide a cable into segments; the first one has the arc on the pulley and the run."""
    count = wp.float64(segments)
    density = density_of(cable, gravity)
    out = CableMesh()
    out.mean_length = (length - arc) / count
    out.mean_rate = rate / count
    share = length_share(0, segments)
    out.first_length = arc + share * out.mean_length
    out.first_rate = share * out.mean_rate
    strain = tension / cable.axial_stiffness
    hanging = arc + out.mean_length + (cable.run_length * strain - arc) / (ONE + strain)
    out.first_mass = density * hanging
    out.mean_mass = density * out.mean_length
    return out


@wp.func
def node_mass(mesh: CableMesh, k: int) -> wp.float64:
    """Return the mass of the node below segment k [kg]."""
    mass = mesh.mean_mass
    if k == 0:
        mass = HALF * (mesh.first_mass + mesh.mean_mass)
    return mass


@wp.func
def wrapped_arc(cable: Cable, node: wp.vec3d) -> wp.float64:
    """Return the length on the pulley of a cable with its first node at `node` [m]."""
    arc = wp.float64(0.0)
    if cable.pulley_radius > ZERO:
        _span, wrap, _unit, _bend, _valid = straight_cable(
            node - cable.exit_point, cable.pulley_radius, cable.swivel_axis
        )
        arc = wrap * cable.pulley_radius
    return arc


@wp.func
def run_strain(cable: Cable, mesh: CableMesh, gravity: wp.float64, unit: wp.vec3d) -> wp.float64:
    """Return the strain of the run by the weight of half the first segment; unit points down."""
    return -HALF * mesh.first_mass * gravity * unit[2] / cable.axial_stiffness


@wp.func
def first_segment(cable: Cable, run: Run, length: wp.float64, mesh: CableMesh, lower: wp.vec3d,
                  velocity: wp.vec3d, predicted: wp.float64, scheme: Scheme,
                  gravity: wp.float64) -> Segment:  # fmt: skip
    """Evaluate the segment at the pulley, with the arc on it and the run behind it."""
    span, wrap, unit, bend, _valid = straight_cable(
        lower - cable.exit_point, cable.pulley_radius, cable.swivel_axis
    )
    rest_length = mesh.first_length + cable.run_length
    # The run feels the tension at the exit: half the weight of this segment more than its middle.
    stretch = span - mesh.first_length - cable.run_length * run_strain(cable, mesh, gravity, unit)
    out = Segment()
    elastic = cable.axial_stiffness * stretch  # over the length at rest: the tension
    stiffness = cable.axial_stiffness
    if grips(cable):
        more = run_strain(cable, mesh, gravity, unit)
        first = mesh.first_length
        pulled = stretched(
            cable, run, length, capstan_exponent(cable, wrap), ONE, first / cable.run_length,
            span - first + first * more,
        )  # fmt: skip
        out.run = pulled.run
        share = cable.axial_stiffness * rest_length / first
        elastic = share * (span - first - pulled.run.stretch)
        stiffness = share * (ONE - ONE / pulled.slope)
    if predicted + mesh.mean_mass * scheme.stiff * stretch > ZERO:
        out.unit = unit
        out.axial = (stiffness + cable.axial_damping / scheme.reach) / rest_length
        out.tension = (
            elastic + cable.axial_damping * (wp.dot(unit, velocity) - mesh.first_rate)
        ) / rest_length
        out.across = wp.max(predicted, ZERO) * bend
    return out


@wp.func
def segment_between(cable: Cable, mesh: CableMesh, upper: wp.vec3d, lower: wp.vec3d,
                    upper_velocity: wp.vec3d, lower_velocity: wp.vec3d, predicted: wp.float64,
                    scheme: Scheme, share: wp.float64) -> Segment:  # fmt: skip
    """Evaluate a segment between two nodes; `share` is its length over the mean."""
    chord = lower - upper
    span = wp.sqrt(wp.dot(chord, chord)) + wp.float64(1.0e-12)
    stretch = span - share * mesh.mean_length
    out = Segment()
    if predicted + mesh.mean_mass * scheme.stiff * stretch > ZERO:
        per_length = ONE / (share * mesh.mean_length)
        unit = chord / span
        out.unit = unit
        out.axial = (cable.axial_stiffness + cable.axial_damping / scheme.reach) * per_length
        out.tension = per_length * (
            cable.axial_stiffness * stretch
            + cable.axial_damping
            * (wp.dot(unit, lower_velocity - upper_velocity) - share * mesh.mean_rate)
        )
        lateral = wp.max(predicted, ZERO) / span  # stiffness of a taut string
        out.across = lateral * (wp.identity(n=3, dtype=wp.float64) - wp.outer(unit, unit))
    return out


@wp.func
def sweep_down(chains: Chains, cable: Cable, run: Run, length: wp.float64, mesh: CableMesh,
               b: int, s: int, i: int,
               scheme: Scheme, gravity: wp.float64, drag: wp.float64, anchor: wp.vec3d,
               anchor_velocity: wp.vec3d,
               anchor_inertial_rate: wp.vec3d) -> AnchorLoad:  # fmt: skip
    """Eliminate the nodes of a chain from the pulley to the anchor point."""
    last = chains.segments - 1
    gravity_vector = wp.vec3d(ZERO, ZERO, -gravity)
    identity = wp.identity(n=3, dtype=wp.float64)
    inertia = scheme.stiff + drag / scheme.reach
    upper = wp.vec3d()
    upper_velocity = wp.vec3d()
    load = wp.vec3d()  # on the upper node, but for the segment below it
    mass = wp.float64(0.0)  # of the upper node
    carried = wp.vec3d()
    stiffness = wp.mat33d()
    out = AnchorLoad()
    for k in range(chains.segments):
        lower = anchor
        velocity = anchor_velocity
        inertial_rate = anchor_inertial_rate
        lower_mass = HALF * mesh.mean_mass
        if k < last:
            v = chains.velocity[b, i, k]
            a = chains.rate[b, i, k]
            velocity = chains.trial[s, i, k]
            lower = chains.position[b, i, k] + increment(scheme, v, a, velocity)
            inertial_rate = rate_felt(scheme, v, a, velocity)
            lower_mass = node_mass(mesh, k)
        segment = Segment()
        if k == 0:
            segment = first_segment(
                cable, run, length, mesh, lower, velocity, chains.predicted[b, i, 0], scheme,
                gravity,
            )  # fmt: skip
            out.run = segment.run
        else:
            segment = segment_between(
                cable, mesh, upper, lower, upper_velocity, velocity, chains.predicted[b, i, k],
                scheme, length_share(k, chains.segments),
            )  # fmt: skip
        matrix = segment.across + segment.axial * wp.outer(segment.unit, segment.unit)
        if k == 0:
            stiffness = matrix
        else:
            inverse = inverse_spd(stiffness + matrix + (mass * inertia) * identity)
            coupling = inverse * matrix
            shift = inverse * (load + carried + segment.tension * segment.unit)
            chains.coupling[s, i, k - 1] = coupling
            chains.shift[s, i, k - 1] = shift
            stiffness = matrix - matrix * coupling
            carried = matrix * shift
        chains.tension_gradient[s, i, k] = segment.axial * segment.unit
        chains.trial_tension[s, i, k] = segment.tension
        load = lower_mass * (gravity_vector - inertial_rate - drag * velocity)
        if k == last:
            chains.end_load[s, i] = load
            chains.end_unit[s, i] = segment.unit
        load = load - segment.tension * segment.unit
        upper = lower
        upper_velocity = velocity
        mass = lower_mass
    out.force = load + carried
    out.stiffness = HALF * (stiffness + wp.transpose(stiffness)) + (mass * inertia) * identity
    return out


@wp.func
def sweep_up(chains: Chains, b: int, s: int, i: int, scheme: Scheme,
             anchor_move: wp.vec3d) -> wp.float64:  # fmt: skip
    """Move the nodes of a chain with its anchor point; return the square of the largest move."""
    lower = anchor_move
    square_max = wp.float64(0.0)
    velocity_per_move = ONE / scheme.reach
    k = chains.segments - 1
    while k > 0:
        move = chains.shift[s, i, k - 1] + chains.coupling[s, i, k - 1] * lower
        chains.predicted[b, i, k] = chains.trial_tension[s, i, k] + wp.dot(
            chains.tension_gradient[s, i, k], lower - move
        )
        chains.trial[s, i, k - 1] = chains.trial[s, i, k - 1] + velocity_per_move * move
        square_max = wp.max(square_max, wp.dot(move, move))
        lower = move
        k -= 1
    chains.predicted[b, i, 0] = chains.trial_tension[s, i, 0] + wp.dot(
        chains.tension_gradient[s, i, 0], lower
    )
    return square_max


@wp.func
def load_chains(plants: Plants, worlds: Worlds, chains: Chains, b: int, s: int, row: int,
                body: DynamicBody, start: BodyMotion, trial: BodyMotion, system: System,
                scheme: Scheme, lane: Lane) -> System:  # fmt: skip
    """Add forces, stiffnesses and friction of all chains to the system of the platform."""
    total = System()
    if lane.index == 0:
        total = system
    turned = turn_since(start, trial)
    for i in range(lane.index, worlds.winch.shape[1], lane.count):
        cable = plants.cables[row, i]
        winch = worlds.winch[b, i]
        mesh = mesh_of(
            cable, winch.length, winch.rate, chains.arc[b, i], chains.predicted[b, i, 0],
            body.gravity, chains.segments,
        )  # fmt: skip
        arm = trial.rotation * (cable.anchor_point - body.center_of_mass)
        velocity = trial.velocity + wp.cross(trial.angular_velocity, arm)
        inertial_rate = rate_felt(
            scheme, worlds.anchor_velocity[b, i], worlds.anchor_rate[b, i], velocity
        )
        load = sweep_down(
            chains, cable, worlds.bristles[b, i].run, winch.length, mesh, b, s, i, scheme,
            body.gravity, body.cable_drag,
            trial.center + arm, velocity, inertial_rate,
        )  # fmt: skip
        force = load.force
        k = load.stiffness
        if rubs(cable):
            before = start.center + start.rotation * (cable.anchor_point - body.center_of_mass)
            rubbing = rub(
                cable, worlds.bristles[b, i], before, trial.center + arm, turned, body.size
            )
            force = force + rubbing.force
            k = k + rubbing.stiffness
            total.moment = total.moment + rubbing.moment
            total.rr = total.rr + rubbing.turning
            bristles = rubbing.bristles
            bristles.run = load.run
            chains.bristles[s, i] = bristles
        total = attach(total, arm, force, k)
    if lane.count > 1:
        total.force = vector_sum(total.force, lane.count)
        total.moment = vector_sum(total.moment, lane.count)
        total.tt = matrix_sum(total.tt, lane.count)
        total.tr = matrix_sum(total.tr, lane.count)
        total.rr = matrix_sum(total.rr, lane.count)
    return total


@wp.func
def move_chains(plants: Plants, chains: Chains, b: int, s: int, row: int, body: DynamicBody,
                trial: BodyMotion, scheme: Scheme, move: wp.vec3d, turn: wp.vec3d, lane: Lane,
                ) -> int:  # fmt: skip
    """Move all nodes with the platform; return the number of threads where one moved far."""
    square_max = wp.float64(0.0)
    for i in range(lane.index, plants.cables.shape[1], lane.count):
        arm = trial.rotation * (plants.cables[row, i].anchor_point - body.center_of_mass)
        square = sweep_up(chains, b, s, i, scheme, move + wp.cross(turn, arm))
        square_max = wp.max(square_max, square)
    far = wp.float64(0.0)
    least = NODE_NEWTON_STEP_MIN * plants.bodies[row].size
    if not square_max < least * least:
        far = ONE
    return int(lane_sum(far, lane.count))


@wp.func
def predict_velocities(chains: Chains, b: int, s: int, n: int, h: wp.float64, lane: Lane):
    """Start the Newton iteration with nodes that keep their acceleration."""
    for i in range(lane.index, n, lane.count):
        for k in range(chains.segments - 1):
            chains.trial[s, i, k] = chains.velocity[b, i, k] + h * chains.rate[b, i, k]


@wp.func
def accept_chains(plants: Plants, worlds: Worlds, chains: Chains, b: int, s: int, row: int,
                  body: DynamicBody, motion: BodyMotion, scheme: Scheme,
                  lane: Lane) -> bool:  # fmt: skip
    """Accept the trial as the end of a time step; return True if the active set has changed."""
    changed = wp.float64(0.0)
    for i in range(lane.index, worlds.winch.shape[1], lane.count):
        for k in range(chains.segments):
            slack = wp.uint8(not chains.predicted[b, i, k] > ZERO)
            if slack != chains.slack[b, i, k]:
                chains.slack[b, i, k] = slack
                changed = ONE
        cable = plants.cables[row, i]
        arm = motion.rotation * (cable.anchor_point - body.center_of_mass)
        velocity = motion.velocity + wp.cross(motion.angular_velocity, arm)
        worlds.anchor_rate[b, i] = rate_after(
            scheme, worlds.anchor_velocity[b, i], worlds.anchor_rate[b, i], velocity
        )
        worlds.anchor_velocity[b, i] = velocity
        if rubs(cable):
            worlds.bristles[b, i] = chains.bristles[s, i]
        last = chains.segments - 1
        end_force = chains.end_load[s, i] - chains.predicted[b, i, last] * chains.end_unit[s, i]
        worlds.tension[b, i] = wp.length(end_force)
        for k in range(last):
            v = chains.velocity[b, i, k]
            a = chains.rate[b, i, k]
            u = chains.trial[s, i, k]
            chains.position[b, i, k] = chains.position[b, i, k] + increment(scheme, v, a, u)
            chains.rate[b, i, k] = rate_after(scheme, v, a, u)
            chains.velocity[b, i, k] = u
        chains.arc[b, i] = wrapped_arc(cable, chains.position[b, i, 0])
    return lane_sum(changed, lane.count) > ZERO


@wp.func
def time_step(plants: Plants, worlds: Worlds, chains: Chains, b: int, s: int, row: int,
              world: WorldState, h: wp.float64, ticks: int, lane: Lane) -> WorldState:  # fmt: skip
    """Take one implicit step; the unstrained lengths are already those at its end.

    A step without a solution is rejected, unless it is as short as can be: one of the `ticks`.
    """
    body = plants.bodies[row]
    start = world.motion
    gusts = blow(plants.winds[row], world.gusts, world.time + h, worlds.seed[b])
    left = FAST_MOTION_SHARE
    if world.rough > 0:
        left = FAST_MOTION_SHARE_ROUGH
    scheme = scheme_of(h, world.last, False, left)
    velocity = start.velocity + h * start.velocity_rate
    omega = start.angular_velocity + h * start.angular_rate
    trial = moved(start, scheme, velocity, omega)
    predict_velocities(chains, b, s, worlds.winch.shape[1], h, lane)
    count = int(0)
    solved = bool(False)
    size = wp.float64(0.0)
    while count < NEWTON_STEPS_MAX and not solved:
        system = inertial_system(body, start, trial, scheme, gusts.force)
        system = load_chains(
            plants, worlds, chains, b, s, row, body, start, trial, system, scheme, lane
        )
        newton = solve_system(system)
        far = move_chains(
            plants, chains, b, s, row, body, trial, scheme, newton.move, newton.turn, lane
        )
        velocity += newton.move / scheme.reach
        omega += newton.turn / scheme.reach
        trial = moved(start, scheme, velocity, omega)
        count += 1
        size = wp.length(newton.move) + body.arm * wp.length(newton.turn)
        solved = size < NEWTON_STEP_MIN * body.size and far == 0
    out = world
    out.accepted = 0
    if solved or ticks == 1:
        out.accepted = 1
        out.iterations = wp.max(world.iterations, count)
        out.residual = wp.max(world.residual, size)
        if not solved:
            out.capped = world.capped + 1
        if not size < body.size or is_lost(trial, body, plants.cables[row, 0].exit_point):
            out.failed = 1
        else:
            out.motion = finish(body, start, trial, scheme)
            out.gusts = gusts
            out.time = world.time + h
            out.last = h
            changed = accept_chains(
                plants, worlds, chains, b, s, row, body, out.motion, scheme, lane
            )
            out.rough = roughness(world.rough, changed)
    return out


@wp.func
def read_world(worlds: Worlds, b: int) -> WorldState:
    """Return a world at the start of a call."""
    out = WorldState()
    out.motion = worlds.motion[b]
    out.gusts = worlds.gusts[b]
    out.last = worlds.last[b]
    out.rough = worlds.rough[b]
    out.failed = worlds.failed[b]
    out.time = worlds.time[b]
    return out


@wp.func
def write_world(worlds: Worlds, b: int, world: WorldState):
    """Store a world at the end of a call; all of its threads write the same."""
    worlds.motion[b] = world.motion
    worlds.gusts[b] = world.gusts
    worlds.last[b] = world.last
    worlds.rough[b] = world.rough
    worlds.failed[b] = world.failed
    worlds.time[b] = world.time
    worlds.iterations[b] = world.iterations
    worlds.capped[b] = world.capped
    worlds.residual[b] = world.residual


@wp.kernel
def advance(plants: Plants, worlds: Worlds, chains: Chains, follow: int, count: int,
            h: wp.float64, lanes: int):  # fmt: skip
    """Advance each world by `count` time steps of h, with `lanes` threads a world."""
    thread = wp.tid()
    b = thread / lanes
    lane = Lane()
    lane.index = thread % lanes
    lane.count = lanes
    s = wp.min(b, chains.trial.shape[0] - 1)
    row = wp.min(b, plants.bodies.shape[0] - 1)
    world = read_world(worlds, b)
    world.failed = wp.max(world.failed, is_nonsense(worlds, b))
    clock = clock_of(h, count)
    while clock.done < clock.ticks and world.failed == 0:
        step = clock.tick * wp.float64(clock.size)
        left = clock.tick * wp.float64(clock.ticks - clock.done)
        turn_winches(plants, worlds, b, row, step, left, follow, lane.index, lanes)
        world = time_step(plants, worlds, chains, b, s, row, world, step, clock.size, lane)
        if world.accepted == 0 or world.failed == 1:
            turn_back(worlds, b, lane.index, lanes)
        clock = clock_after(clock, world.accepted)
    write_world(worlds, b, world)
    publish(plants, worlds, b, row, lane.index, lanes)
