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
A segment drops out while its predicted tension and its stretch say that it is slack.
"""

import warp as wp

from carosac_toolkit.physics.cable.catenary_kernels import HALF, ONE, ZERO, Cable, density_of
from carosac_toolkit.physics.cable.straight_line_kernels import straight_cable
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
from carosac_toolkit.physics.motion.world_kernels import (
    NEWTON_STEP_MIN_M,
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

# Weights of the end-corrected midpoint rule.
SHARE_0 = wp.constant(wp.float64(13.0 / 12.0))
SHARE_1 = wp.constant(wp.float64(7.0 / 8.0))
SHARE_2 = wp.constant(wp.float64(25.0 / 24.0))
NODE_STEP = wp.constant(wp.float64(1.0e-6))  # [m] a smaller Newton step of all nodes is the last


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
    """Sum over the threads of a world, the same bits in all of them; they come in powers of two."""
    ...


@wp.func
def vector_sum(v: wp.vec3d, lanes: int) -> wp.vec3d:
    """`lane_sum` of each entry."""
    return wp.vec3d(lane_sum(v[0], lanes), lane_sum(v[1], lanes), lane_sum(v[2], lanes))


@wp.func
def matrix_sum(m: wp.mat33d, lanes: int) -> wp.mat33d:
    """`lane_sum` of each entry."""
    return wp.matrix_from_rows(
        vector_sum(m[0], lanes), vector_sum(m[1], lanes), vector_sum(m[2], lanes)
    )


@wp.struct
class Lane:
    """A thread of a world, which has every so many-th of the cables; one does it all on a CPU."""

    index: int
    count: int


@wp.struct
class Flight:
    """One world in the course of a call, the same in all of its threads."""

    motion: BodyMotion
    gusts: Gusts
    last: wp.float64  # size of the last step [s]
    slack: wp.float64  # stands for which segments are slack
    rough: int  # steps to go since that has changed
    failed: int
    time: wp.float64  # [s]
    iterations: int
    capped: int
    residual: wp.float64  # [m]
    taken: int  # whether the last step was


@wp.struct
class Chains:
    """Nodes and segments of B worlds of n cables; index k of a node is that of the segment above.

    Scratch arrays have one row where worlds are computed one after the other.
    """

    position: wp.array3d(dtype=wp.vec3d)  # of nodes [m], (B, n, N - 1)
    velocity: wp.array3d(dtype=wp.vec3d)  # [m/s]
    rate: wp.array3d(dtype=wp.vec3d)  # algorithmic acceleration [m/s^2]
    predicted: wp.array3d(dtype=wp.float64)  # tension of segments [N], (B, n, N)
    arc: wp.array2d(dtype=wp.float64)  # wrapped on the pulley [m], (B, n)
    trial: wp.array3d(dtype=wp.vec3d)  # scratch: velocity at the end of the step [m/s]
    follow: wp.array3d(dtype=wp.mat33d)  # scratch: motion of a node per motion of the next
    shift: wp.array3d(dtype=wp.vec3d)  # scratch: motion of a node with the next one fixed [m]
    pull: wp.array3d(dtype=wp.vec3d)  # scratch: axial stiffness times direction [N/m]
    tension: wp.array3d(dtype=wp.float64)  # scratch: at the trial positions [N]
    end_load: wp.array2d(dtype=wp.vec3d)  # scratch: weight less inertia of the last half segment
    end_unit: wp.array2d(dtype=wp.vec3d)  # scratch: direction of the last segment
    drag: wp.float64  # air drag per mass of cable [1/s]
    segments: int


@wp.struct
class Segment:
    """One segment at trial positions."""

    unit: wp.vec3d  # from its upper to its lower end
    tension: wp.float64  # [N]
    axial: wp.float64  # stiffness along it within a time step [N/m]
    across: wp.mat33d  # stiffness across it [N/m]


@wp.struct
class Feed:
    """How the unstrained length of a cable is shared out."""

    first: wp.float64  # datum to the first node [m]
    other: wp.float64  # mean of the segments [m]
    first_rate: wp.float64  # [m/s]
    other_rate: wp.float64
    first_mass: wp.float64  # that hangs in the first segment [kg]
    other_mass: wp.float64


@wp.struct
class End:
    """What a chain does to its anchor point, its nodes eliminated."""

    force: wp.vec3d
    stiffness: wp.mat33d


@wp.func
def inverse_spd(m: wp.mat33d) -> wp.mat33d:
    """Inverse of a symmetric positive definite matrix."""
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
    """Unstrained length of a segment over the mean, chosen so that chains hang as catenaries do.

    A chain of equal loads sums up, segment by segment, what a catenary integrates: the midpoint
    rule. With these weights near the ends it has fourth order instead of second.
    """
    end = wp.min(k, segments - 1 - k)
    share = wp.float64(1.0)
    if segments >= 6:
        if end == 0:
            share = SHARE_0
        if end == 1:
            share = SHARE_1
        if end == 2:
            share = SHARE_2
    return share


@wp.func
def share_out(cable: Cable, length: wp.float64, rate: wp.float64, arc: wp.float64,
              tension: wp.float64, gravity: wp.float64, segments: int) -> Feed:  # fmt: skip
    """What is on the pulley and what came from the run is in the first segment."""
    count = wp.float64(segments)
    density = density_of(cable, gravity)
    out = Feed()
    out.other = (length - arc) / count
    out.other_rate = rate / count
    share = length_share(0, segments)
    out.first = arc + share * out.other
    out.first_rate = share * out.other_rate
    strain = tension / cable.axial_stiffness
    hanging = arc + out.other + (cable.run_length * strain - arc) / (ONE + strain)
    out.first_mass = density * hanging
    out.other_mass = density * out.other
    return out


@wp.func
def node_mass(feed: Feed, k: int) -> wp.float64:
    """Mass of the node below segment k [kg]."""
    mass = feed.other_mass
    if k == 0:
        mass = HALF * (feed.first_mass + feed.other_mass)
    return mass


@wp.func
def wrapped_arc(cable: Cable, node: wp.vec3d) -> wp.float64:
    """Length on the pulley of a cable whose first node is there [m]."""
    arc = wp.float64(0.0)
    if cable.pulley_radius > ZERO:
        _span, wrap, _unit, _bend, _valid = straight_cable(
            node - cable.exit_point, cable.pulley_radius, cable.swivel_axis
        )
        arc = wrap * cable.pulley_radius
    return arc


@wp.func
def run_strain(cable: Cable, feed: Feed, gravity: wp.float64, unit: wp.vec3d) -> wp.float64:
    """Strain of the run by the weight of the upper half of the first segment; unit points down."""
    return -HALF * feed.first_mass * gravity * unit[2] / cable.axial_stiffness


@wp.func
def first_segment(cable: Cable, feed: Feed, lower: wp.vec3d, velocity: wp.vec3d,
                  predicted: wp.float64, scheme: Scheme,
                  gravity: wp.float64) -> Segment:  # fmt: skip
    """The segment at the pulley, with the arc on it and the run behind it."""
    span, _wrap, unit, bend, _valid = straight_cable(
        lower - cable.exit_point, cable.pulley_radius, cable.swivel_axis
    )
    whole = feed.first + cable.run_length
    # The run feels the tension at the exit: half the weight of this segment more than its middle.
    stretch = span - feed.first - cable.run_length * run_strain(cable, feed, gravity, unit)
    out = Segment()
    if predicted + feed.other_mass * scheme.stiff * stretch > ZERO:
        out.unit = unit
        out.axial = (cable.axial_stiffness + cable.axial_damping / scheme.reach) / whole
        out.tension = (
            cable.axial_stiffness * stretch
            + cable.axial_damping * (wp.dot(unit, velocity) - feed.first_rate)
        ) / whole
        out.across = wp.max(predicted, ZERO) * bend
    return out


@wp.func
def segment_between(cable: Cable, feed: Feed, upper: wp.vec3d, lower: wp.vec3d,
                    upper_velocity: wp.vec3d, lower_velocity: wp.vec3d, predicted: wp.float64,
                    scheme: Scheme, share: wp.float64) -> Segment:  # fmt: skip
    """A segment between two nodes; `share` is its length over the mean."""
    d = lower - upper
    span = wp.sqrt(wp.dot(d, d)) + wp.float64(1.0e-12)
    stretch = span - share * feed.other
    out = Segment()
    if predicted + feed.other_mass * scheme.stiff * stretch > ZERO:
        per = ONE / (share * feed.other)
        unit = d / span
        out.unit = unit
        out.axial = (cable.axial_stiffness + cable.axial_damping / scheme.reach) * per
        out.tension = per * (
            cable.axial_stiffness * stretch
            + cable.axial_damping
            * (wp.dot(unit, lower_velocity - upper_velocity) - share * feed.other_rate)
        )
        b = wp.max(predicted, ZERO) / span
        out.across = b * (wp.identity(n=3, dtype=wp.float64) - wp.outer(unit, unit))
    return out


@wp.func
def sweep_down(chains: Chains, cable: Cable, feed: Feed, b: int, s: int, i: int, scheme: Scheme,
               gravity: wp.float64, anchor: wp.vec3d, anchor_velocity: wp.vec3d,
               anchor_felt: wp.vec3d) -> End:  # fmt: skip
    """Eliminate the nodes of a chain from the pulley to the anchor point."""
    last = chains.segments - 1
    fall = wp.vec3d(ZERO, ZERO, -gravity)
    unity = wp.identity(n=3, dtype=wp.float64)
    inertia = scheme.stiff + chains.drag / scheme.reach
    upper = wp.vec3d()
    upper_velocity = wp.vec3d()
    load = wp.vec3d()  # on the upper node, but for the segment below it
    mass = wp.float64(0.0)  # of the upper node
    carried = wp.vec3d()
    stiffness = wp.mat33d()
    for k in range(chains.segments):
        lower = anchor
        velocity = anchor_velocity
        felt = anchor_felt
        lower_mass = HALF * feed.other_mass
        if k < last:
            v = chains.velocity[b, i, k]
            a = chains.rate[b, i, k]
            velocity = chains.trial[s, i, k]
            lower = chains.position[b, i, k] + increment(scheme, v, a, velocity)
            felt = rate_felt(scheme, v, a, velocity)
            lower_mass = node_mass(feed, k)
        part = Segment()
        if k == 0:
            part = first_segment(
                cable, feed, lower, velocity, chains.predicted[b, i, 0], scheme, gravity
            )
        else:
            part = segment_between(
                cable, feed, upper, lower, upper_velocity, velocity, chains.predicted[b, i, k],
                scheme, length_share(k, chains.segments),
            )  # fmt: skip
        matrix = part.across + part.axial * wp.outer(part.unit, part.unit)
        if k == 0:
            stiffness = matrix
        else:
            inverse = inverse_spd(stiffness + matrix + (mass * inertia) * unity)
            follow = inverse * matrix
            shift = inverse * (load + carried + part.tension * part.unit)
            chains.follow[s, i, k - 1] = follow
            chains.shift[s, i, k - 1] = shift
            stiffness = matrix - matrix * follow
            carried = matrix * shift
        chains.pull[s, i, k] = part.axial * part.unit
        chains.tension[s, i, k] = part.tension
        load = lower_mass * (fall - felt - chains.drag * velocity)
        if k == last:
            chains.end_load[s, i] = load
            chains.end_unit[s, i] = part.unit
        load = load - part.tension * part.unit
        upper = lower
        upper_velocity = velocity
        mass = lower_mass
    out = End()
    out.force = load + carried
    out.stiffness = HALF * (stiffness + wp.transpose(stiffness)) + (mass * inertia) * unity
    return out


@wp.func
def sweep_up(chains: Chains, b: int, s: int, i: int, scheme: Scheme,
             anchor_move: wp.vec3d) -> wp.float64:  # fmt: skip
    """Move the nodes of a chain after its anchor point; return the square of the largest move."""
    lower = anchor_move
    most = wp.float64(0.0)
    per = ONE / scheme.reach
    k = chains.segments - 1
    while k > 0:
        move = chains.shift[s, i, k - 1] + chains.follow[s, i, k - 1] * lower
        chains.predicted[b, i, k] = chains.tension[s, i, k] + wp.dot(
            chains.pull[s, i, k], lower - move
        )
        chains.trial[s, i, k - 1] = chains.trial[s, i, k - 1] + per * move
        most = wp.max(most, wp.dot(move, move))
        lower = move
        k -= 1
    chains.predicted[b, i, 0] = chains.tension[s, i, 0] + wp.dot(chains.pull[s, i, 0], lower)
    return most


@wp.func
def load_chains(plants: Plants, worlds: Worlds, chains: Chains, b: int, s: int, row: int,
                body: DynamicBody, trial: BodyMotion, system: System, scheme: Scheme, lane: Lane,
                ) -> System:  # fmt: skip
    """Add what all chains do to the platform."""
    total = System()
    if lane.index == 0:
        total = system
    for i in range(lane.index, worlds.winch.shape[1], lane.count):
        cable = plants.cables[row, i]
        winch = worlds.winch[b, i]
        feed = share_out(
            cable, winch.length, winch.rate, chains.arc[b, i], chains.predicted[b, i, 0],
            body.gravity, chains.segments,
        )  # fmt: skip
        arm = trial.rotation * (cable.anchor_point - body.center_of_mass)
        velocity = trial.velocity + wp.cross(trial.angular_velocity, arm)
        felt = rate_felt(scheme, worlds.anchor_velocity[b, i], worlds.anchor_rate[b, i], velocity)
        end = sweep_down(
            chains, cable, feed, b, s, i, scheme, body.gravity, trial.center + arm, velocity, felt
        )
        total = attach(total, arm, end.force, end.stiffness)
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
    """Move all nodes after the platform; return in how many threads one moved far."""
    most = wp.float64(0.0)
    for i in range(lane.index, plants.cables.shape[1], lane.count):
        arm = trial.rotation * (plants.cables[row, i].anchor_point - body.center_of_mass)
        square = sweep_up(chains, b, s, i, scheme, move + wp.cross(turn, arm))
        most = wp.max(most, square)
    far = wp.float64(0.0)
    if not most < NODE_STEP * NODE_STEP:
        far = ONE
    return int(lane_sum(far, lane.count))


@wp.func
def begin_chains(chains: Chains, b: int, s: int, n: int, h: wp.float64, lane: Lane):
    """Nodes are expected to keep their acceleration."""
    for i in range(lane.index, n, lane.count):
        for k in range(chains.segments - 1):
            chains.trial[s, i, k] = chains.velocity[b, i, k] + h * chains.rate[b, i, k]


@wp.func
def keep_chains(plants: Plants, worlds: Worlds, chains: Chains, b: int, s: int, row: int,
                body: DynamicBody, motion: BodyMotion, scheme: Scheme,
                lane: Lane) -> wp.float64:  # fmt: skip
    """Accept the trial as the end of a time step; say which segments are slack, by a number."""
    slack = wp.float64(0.0)
    for i in range(lane.index, worlds.winch.shape[1], lane.count):
        for k in range(chains.segments):
            if not chains.predicted[b, i, k] > ZERO:
                slack += wp.float64(1 + k + i * chains.segments) + HALF * wp.float64(k * k)
        cable = plants.cables[row, i]
        arm = motion.rotation * (cable.anchor_point - body.center_of_mass)
        velocity = motion.velocity + wp.cross(motion.angular_velocity, arm)
        worlds.anchor_rate[b, i] = rate_after(
            scheme, worlds.anchor_velocity[b, i], worlds.anchor_rate[b, i], velocity
        )
        worlds.anchor_velocity[b, i] = velocity
        last = chains.segments - 1
        end = chains.end_load[s, i] - chains.predicted[b, i, last] * chains.end_unit[s, i]
        worlds.tension[b, i] = wp.length(end)
        for k in range(last):
            v = chains.velocity[b, i, k]
            a = chains.rate[b, i, k]
            u = chains.trial[s, i, k]
            chains.position[b, i, k] = chains.position[b, i, k] + increment(scheme, v, a, u)
            chains.rate[b, i, k] = rate_after(scheme, v, a, u)
            chains.velocity[b, i, k] = u
        chains.arc[b, i] = wrapped_arc(cable, chains.position[b, i, 0])
    return lane_sum(slack, lane.count)


@wp.func
def time_step(plants: Plants, worlds: Worlds, chains: Chains, b: int, s: int, row: int,
              flight: Flight, h: wp.float64, ticks: int, lane: Lane) -> Flight:  # fmt: skip
    """One implicit step; lengths are those at its end already. `taken` says whether it was taken.

    A step without a solution is taken only if it is as short as can be, one of the `ticks`.
    """
    body = plants.bodies[row]
    start = flight.motion
    gusts = blow(plants.winds[row], flight.gusts, flight.time + h, worlds.seed[b])
    left = FAST_MOTION_SHARE
    if flight.rough > 0:
        left = FAST_MOTION_SHARE_ROUGH
    scheme = scheme_of(h, flight.last, False, left)
    velocity = start.velocity + h * start.velocity_rate
    omega = start.angular_velocity + h * start.angular_rate
    trial = moved(start, scheme, velocity, omega)
    begin_chains(chains, b, s, worlds.winch.shape[1], h, lane)
    count = int(0)
    solved = bool(False)
    size = wp.float64(0.0)
    while count < NEWTON_STEPS_MAX and not solved:
        system = inertial_system(body, start, trial, scheme, gusts.force)
        system = load_chains(plants, worlds, chains, b, s, row, body, trial, system, scheme, lane)
        newton = solve_system(system)
        far = move_chains(
            plants, chains, b, s, row, body, trial, scheme, newton.move, newton.turn, lane
        )
        velocity += newton.move / scheme.reach
        omega += newton.turn / scheme.reach
        trial = moved(start, scheme, velocity, omega)
        count += 1
        size = wp.length(newton.move) + body.arm * wp.length(newton.turn)
        solved = size < NEWTON_STEP_MIN_M and far == 0
    out = flight
    out.taken = 0
    if solved or ticks == 1:
        out.taken = 1
        out.iterations = wp.max(flight.iterations, count)
        out.residual = wp.max(flight.residual, size)
        if not solved:
            out.capped = flight.capped + 1
        if not size < body.size or is_lost(trial, body, plants.cables[row, 0].exit_point):
            out.failed = 1
        else:
            out.motion = finish(body, start, trial, scheme)
            out.gusts = gusts
            out.time = flight.time + h
            out.last = h
            out.slack = keep_chains(
                plants, worlds, chains, b, s, row, body, out.motion, scheme, lane
            )
            out.rough = roughness(flight.rough, flight.slack, out.slack)
    return out


@wp.func
def taken_off(worlds: Worlds, b: int) -> Flight:
    """A world at the start of a call."""
    out = Flight()
    out.motion = worlds.motion[b]
    out.gusts = worlds.gusts[b]
    out.last = worlds.last[b]
    out.slack = worlds.slack[b]
    out.rough = worlds.rough[b]
    out.failed = worlds.failed[b]
    out.time = worlds.time[b]
    return out


@wp.func
def land(worlds: Worlds, b: int, flight: Flight):
    """A world at the end of a call; all of its threads write the same."""
    worlds.motion[b] = flight.motion
    worlds.gusts[b] = flight.gusts
    worlds.last[b] = flight.last
    worlds.slack[b] = flight.slack
    worlds.rough[b] = flight.rough
    worlds.failed[b] = flight.failed
    worlds.time[b] = flight.time
    worlds.iterations[b] = flight.iterations
    worlds.capped[b] = flight.capped
    worlds.residual[b] = flight.residual


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
    flight = taken_off(worlds, b)
    flight.failed = wp.max(flight.failed, is_nonsense(worlds, b))
    clock = clock_of(h, count)
    while clock.done < clock.ticks and flight.failed == 0:
        step = clock.tick * wp.float64(clock.size)
        left = clock.tick * wp.float64(clock.ticks - clock.done)
        turn_winches(plants, worlds, b, row, step, left, follow, lane.index, lanes)
        flight = time_step(plants, worlds, chains, b, s, row, flight, step, clock.size, lane)
        if flight.taken == 0 or flight.failed == 1:
            turn_back(worlds, b, lane.index, lanes)
        clock = clock_after(clock, flight.taken)
    land(worlds, b, flight)
    publish(plants, worlds, b, row, lane.index, lanes)
