"""Chains of particles at rest: the discrete equilibrium near a continuous one, in float64 Warp.

The unknown of a chain is the tension vector of its first segment; all others follow node by node,
as each node hangs from the one above. So a chain has the closure and the stiffness that
`cable_kernels.hang` gives of a catenary, and the platform is brought to rest by the same Newton.
"""

import warp as wp

from carosac_toolkit.physics.cable.catenary_kernels import HALF, ONE, ZERO, inverse33, pulley_wrap
from carosac_toolkit.physics.cable.straight_line_kernels import straight_cable
from carosac_toolkit.physics.device_kernels import Cable
from carosac_toolkit.physics.motion.body_kernels import System, attach, solve_system
from carosac_toolkit.physics.motion.world_kernels import Plants, Worlds
from carosac_toolkit.physics.rest.platform_kernels import orthonormal, rotation_of
from sim_warp.particle_kernels import (
    CableMesh,
    Chains,
    length_share,
    mesh_of,
    node_mass,
    run_strain,
)

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

# Distance of nodes from their cable, over l times the turn there: ends of the chain, and inside.
NODE_OFFSET_0 = wp.constant(wp.float64(13.0 / 288.0))
NODE_OFFSET_1 = wp.constant(wp.float64(73.0 / 1152.0))
NODE_OFFSET_INSIDE = wp.constant(wp.float64(1.0 / 24.0))
REST_NEWTON_STEPS_MAX = wp.constant(20)
CLOSURE_TOLERANCE = wp.constant(wp.float64(1.0e-13))  # of the typical length
BALANCE_TOLERANCE = wp.constant(wp.float64(1.0e-11))  # of the weight


@wp.struct
class HangingChain:
    """A chain for one tension vector of its first segment."""

    closure: wp.vec3d  # anchor + chain - tangent point [m]
    closure_t: wp.mat33d  # d closure / d tension vector [m/N]
    force: wp.vec3d  # on the platform [N]
    arc: wp.float64  # on the pulley [m]


@wp.func
def first_span(cable: Cable, mesh: CableMesh, gravity: wp.float64, unit: wp.vec3d,
               strain: wp.float64) -> wp.float64:  # fmt: skip
    """Return the stretched length from the datum to the first node with the run; unit points up."""
    more = run_strain(cable, mesh, gravity, -unit)
    return mesh.first_length * (ONE + strain) + cable.run_length * (strain + more)


@wp.func
def hang_chain(t: wp.vec3d, anchor: wp.vec3d, length: wp.float64, cable: Cable,
               gravity: wp.float64, segments: int) -> HangingChain:  # fmt: skip
    """Evaluate a chain at rest; t points from the first node to the pulley."""
    wrap = pulley_wrap(t, cable)
    out = HangingChain()
    out.arc = cable.pulley_radius * wrap.angle
    mesh = mesh_of(cable, length, ZERO, out.arc, wp.length(t), gravity, segments)
    count = wp.float64(segments)
    reach = wp.vec3d()
    compliance = wp.mat33d()
    units = wp.vec3d()
    pull = t
    last = segments - 1
    for k in range(segments):
        tension = wp.length(pull)
        unit = pull / tension
        strain = tension / cable.axial_stiffness
        piece = length_share(k, segments) * mesh.mean_length
        span = piece * (ONE + strain)
        axial = piece / cable.axial_stiffness
        mass = node_mass(mesh, k)
        if k == 0:
            span = first_span(cable, mesh, gravity, unit, strain) - out.arc
            axial = (mesh.first_length + cable.run_length) / cable.axial_stiffness
        if k == last:
            mass = HALF * mesh.mean_mass
        reach = reach + span * unit
        units = units + length_share(k, segments) * unit
        turn = span / tension
        compliance = (
            compliance
            + turn * wp.identity(n=3, dtype=wp.float64)
            + (axial - turn) * wp.outer(unit, unit)
        )
        pull = pull - wp.vec3d(ZERO, ZERO, mass * gravity)
    out.force = pull
    out.closure = anchor + reach - wrap.tangent_point
    out.closure_t = (
        compliance
        - wrap.tangent_point_q
        - wp.outer(units, (cable.pulley_radius / count) * wrap.angle_q)
    )
    return out


@wp.func
def close_chain(guess: wp.vec3d, anchor: wp.vec3d, length: wp.float64, cable: Cable,
                gravity: wp.float64, segments: int, tolerance: wp.float64,
                ) -> wp.vec3d:  # fmt: skip
    """Solve for the tension vector of the first segment that closes the chain."""
    t = guess
    chain = hang_chain(t, anchor, length, cable, gravity, segments)
    iterations = int(0)
    while wp.length(chain.closure) > tolerance and iterations < REST_NEWTON_STEPS_MAX:
        step = -(inverse33(chain.closure_t) * chain.closure)
        # At most half of the tension: a slack segment would reverse its direction.
        share = wp.min(ONE, HALF * wp.length(t) / (wp.length(step) + wp.float64(1.0e-30)))
        t = t + share * step
        chain = hang_chain(t, anchor, length, cable, gravity, segments)
        iterations += 1
    return t


@wp.kernel
def settle_chains(plants: Plants, chains: Chains, which: wp.array(dtype=int),
                  position: wp.array(dtype=wp.vec3d), rotation: wp.array(dtype=wp.mat33d),
                  length: wp.array2d(dtype=wp.float64), q: wp.array2d(dtype=wp.vec3d),
                  tension: wp.array2d(dtype=wp.float64), at_rest: int,
                  gap: wp.array(dtype=wp.float64)):  # fmt: skip
    """Bring pose and tension vectors of continuous equilibria to discrete ones, in place.

    Where the platform is not at rest its pose stays, and only the chains are closed.
    """
    j = wp.tid()
    row = wp.min(which[j], plants.bodies.shape[0] - 1)
    body = plants.bodies[row]
    r = rotation[j]
    center = position[j] + r * body.center_of_mass
    n = length.shape[1]
    for i in range(n):
        cable = plants.cables[row, i]
        half = HALF * cable.weight_per_length * length[j, i] / wp.float64(chains.segments)
        q[j, i] = q[j, i] - wp.vec3d(ZERO, ZERO, half)
    iterations = int(0)
    unbalanced = bool(True)
    while unbalanced:
        gap[j] = ZERO
        system = System()
        system.force = wp.vec3d(ZERO, ZERO, -body.mass * body.gravity)
        for i in range(n):
            cable = plants.cables[row, i]
            arm = r * (cable.anchor_point - body.center_of_mass)
            anchor = center + arm
            t = close_chain(
                q[j, i], anchor, length[j, i], cable, body.gravity, chains.segments,
                CLOSURE_TOLERANCE * body.size,
            )  # fmt: skip
            q[j, i] = t
            chain = hang_chain(t, anchor, length[j, i], cable, body.gravity, chains.segments)
            k = inverse33(chain.closure_t)
            tension[j, i] = wp.length(chain.force)
            gap[j] = wp.max(gap[j], wp.length(chain.closure))
            system = attach(system, arm, chain.force, HALF * (k + wp.transpose(k)))
        residual = wp.length(system.force) + wp.length(system.moment) / body.arm
        iterations += 1
        unbalanced = (
            at_rest == 1
            and residual > BALANCE_TOLERANCE * body.mass * body.gravity
            and iterations < REST_NEWTON_STEPS_MAX
        )
        if unbalanced:
            newton = solve_system(system)
            center = center + newton.move
            r = orthonormal(rotation_of(newton.turn) * r)
    if at_rest == 1:
        rotation[j] = r
        position[j] = center - r * body.center_of_mass


@wp.func
def node_offset(k: int, segments: int) -> wp.float64:
    """Return the distance of a node from the cable of its chain, over l times the turn there.

    Segments of a chain are tangents of its catenary, and nodes lie outside of it.
    """
    end = wp.min(k, segments - 2 - k)
    share = wp.float64(0.0)
    if segments >= 6:
        share = NODE_OFFSET_INSIDE
        if end == 0:
            share = NODE_OFFSET_0
        if end == 1:
            share = NODE_OFFSET_1
    return share


@wp.kernel
def chain_points(plants: Plants, worlds: Worlds, chains: Chains,
                 points: wp.array3d(dtype=wp.vec3d)):  # fmt: skip
    """Compute points on the cables, tangent to anchor point; one thread per world and cable."""
    b, i = wp.tid()
    row = wp.min(b, plants.bodies.shape[0] - 1)
    cable = plants.cables[row, i]
    last = chains.segments
    length = worlds.winch[b, i].length - chains.arc[b, i]
    piece = length / wp.float64(chains.segments)
    anchor = worlds.position[b] + worlds.rotation[b] * cable.anchor_point
    _span, _wrap, unit, _bend, _valid = straight_cable(
        chains.position[b, i, 0] - cable.exit_point, cable.pulley_radius, cable.swivel_axis
    )
    points[b, i, last] = anchor
    for k in range(last - 1):
        here = chains.position[b, i, k]
        below = anchor
        if k < last - 2:
            below = chains.position[b, i, k + 1]
        next_unit = wp.normalize(below - here)
        turn = next_unit - unit
        if k == 0:  # the cable leaves the pulley half a segment before the chain has its direction
            points[b, i, 0] = pulley_wrap(HALF * turn - unit, cable).tangent_point
        points[b, i, k + 1] = here + (node_offset(k, chains.segments) * piece) * turn
        unit = next_unit


@wp.kernel
def place_chains(plants: Plants, worlds: Worlds, chains: Chains, which: wp.array(dtype=int),
                 q: wp.array2d(dtype=wp.vec3d)):  # fmt: skip
    """Place the nodes of placed worlds, moving with the platform; one thread per row."""
    j = wp.tid()
    b = which[j]
    row = wp.min(b, plants.bodies.shape[0] - 1)
    body = plants.bodies[row]
    count = wp.float64(chains.segments)
    for i in range(worlds.winch.shape[1]):
        cable = plants.cables[row, i]
        pull = q[j, i]
        wrap = pulley_wrap(pull, cable)
        arc = cable.pulley_radius * wrap.angle
        mesh = mesh_of(
            cable, worlds.winch[b, i].length, ZERO, arc, wp.length(pull), body.gravity,
            chains.segments,
        )  # fmt: skip
        chains.arc[b, i] = arc
        point = wrap.tangent_point
        for k in range(chains.segments):
            tension = wp.length(pull)
            strain = tension / cable.axial_stiffness
            span = length_share(k, chains.segments) * mesh.mean_length * (ONE + strain)
            if k == 0:
                span = first_span(cable, mesh, body.gravity, pull / tension, strain) - arc
            point = point - (span / tension) * pull
            chains.predicted[b, i, k] = tension
            chains.slack[b, i, k] = wp.uint8(0)
            if k < chains.segments - 1:
                chains.position[b, i, k] = point
                share = wp.float64(k + 1) / count
                chains.velocity[b, i, k] = share * worlds.anchor_velocity[b, i]
                chains.rate[b, i, k] = wp.vec3d()
            pull = pull - wp.vec3d(ZERO, ZERO, node_mass(mesh, k) * body.gravity)
