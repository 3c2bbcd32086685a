"""Dry friction where cables end, in float64 Warp: Dahl's model of presliding.

What rubs is held by bristles. They bend by the slip between both sides, in radians here, and slide
once they are bent by `PRESLIDING_ANGLE`: with the slip s of a time step the bend z becomes

    z' = exp(-a) z + (1 - exp(-a)) / a s,    a = |s| / PRESLIDING_ANGLE,

which solves Dahl's law dz = ds - z |ds| / PRESLIDING_ANGLE for a slip in one direction. The moment
is the dry one times z / PRESLIDING_ANGLE: a spring for small slips, Coulomb friction for large
ones, at every speed alike. The bristles never give back more energy than they took.
`capstan_kernels` has the friction of a cable on its pulley.

Two moments rub at each cable. At its exit the swivel of a pulley resists turning about its axis,
and an eyelet turning of the cable in any direction. At its anchor the joint resists turning of the
platform against the cable, but for the twist about the cable. Both see the cable as a rod from
exit point to anchor. By virtual power, a moment that resists a turn of the cable also pulls across
the cable at the anchor, by the moment over the length.

References:
    Dahl, *A solid friction model*, The Aerospace Corporation, 1968.
"""

import warp as wp

from carosac_toolkit.physics.cable.catenary_kernels import ONE, ZERO
from carosac_toolkit.physics.device_kernels import Cable
from carosac_toolkit.physics.motion.body_kernels import BodyMotion
from carosac_toolkit.physics.motion.capstan_kernels import SMALL_SLIP, Run, bend_gain, grips

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

PRESLIDING_ANGLE = wp.constant(wp.float64(0.01))  # [rad]: bend of bristles that slide
DISTANCE_MIN = wp.constant(wp.float64(1.0e-9))  # of the anchor, in typical lengths: no division


@wp.struct
class Bristles:
    """Bend at both ends of a cable, in W [rad], each at right angles to it, and on its pulley."""

    exit: wp.vec3d
    anchor: wp.vec3d
    run: Run


@wp.struct
class Rubbing:
    """What friction at both ends of a cable does to the platform."""

    force: wp.vec3d  # at the anchor point [N]
    stiffness: wp.mat33d  # -d force / d anchor point, about [N/m]
    moment: wp.vec3d  # beside that of the force [N m]
    turning: wp.mat33d  # -d moment / d rotation vector, about [N m]
    bristles: Bristles


@wp.func
def rubs(cable: Cable) -> bool:
    """Return true if a cable has any dry friction."""
    return cable.exit_friction + cable.anchor_friction > ZERO or grips(cable)


@wp.struct
class Bent:
    """Bristles after a slip."""

    bend: wp.vec3d
    slope: wp.mat33d  # by the slip, without its asymmetric part; not negative


@wp.func
def bent(z: wp.vec3d, slip: wp.vec3d, across: wp.mat33d) -> Bent:
    """Return the bend of bristles after a slip; both lie where the projection `across` leads."""
    size = wp.length(slip)
    a = size / PRESLIDING_ANGLE
    kept = wp.exp(-a)
    gain = bend_gain(a, kept)
    out = Bent()
    out.bend = kept * z + gain * slip
    out.slope = gain * across
    if a > SMALL_SLIP:
        way = slip / size
        along = kept * wp.max(ONE - wp.dot(z, way) / PRESLIDING_ANGLE, ZERO)
        out.slope = out.slope + (along - gain) * wp.outer(way, way)
    return out


@wp.func
def slid(rate: wp.vec3d, time: wp.float64) -> wp.vec3d:
    """Return the bend of bristles that a rate [rad/s] has been sliding for some time [s].

    It has no kink at rest, where nothing is known of what was before.
    """
    return rate * (time / (ONE + wp.length(rate) * time / PRESLIDING_ANGLE))


@wp.struct
class Lines:
    """Directions in which a cable turns: by exit point and anchor alone, as a rod."""

    cable: wp.vec3d  # unit vector, exit point to anchor
    across: wp.mat33d  # projection on the directions that turn it
    per_length: wp.float64  # [1/m]
    exit_across: wp.mat33d  # on those that rub at the exit
    exit_per_length: wp.float64  # [1/m]


@wp.func
def lines_of(cable: Cable, anchor: wp.vec3d, size: wp.float64) -> Lines:
    """Return the directions of a cable to an anchor in W; `size` is a typical length [m]."""
    rod = anchor - cable.exit_point
    out = Lines()
    length = wp.max(wp.length(rod), DISTANCE_MIN * size)
    out.cable = rod / length
    out.per_length = ONE / length
    out.across = wp.identity(n=3, dtype=wp.float64) - wp.outer(out.cable, out.cable)
    out.exit_across = out.across
    out.exit_per_length = out.per_length
    if cable.pulley_radius > ZERO:
        k = cable.swivel_axis
        outward = rod - wp.dot(rod, k) * k
        radius = wp.length(outward)
        out.exit_per_length = ONE / wp.max(radius, cable.pulley_radius)
        side = wp.cross(k, outward) / wp.max(radius, DISTANCE_MIN * size)
        out.exit_across = wp.outer(side, side)
    return out


@wp.func
def slid_bristles(cable: Cable, anchor: wp.vec3d, velocity: wp.vec3d, omega: wp.vec3d,
                  size: wp.float64, time: wp.float64) -> Bristles:  # fmt: skip
    """Return the bristles of a cable whose platform has been moving for some time [s].

    Args:
        cable: The cable.
        anchor: Its anchor point in W [m].
        velocity: Of the anchor point [m/s].
        omega: Angular velocity of the platform [rad/s].
        size: Typical length [m].
        time: [s].
    """
    lines = lines_of(cable, anchor, size)
    out = Bristles()
    out.exit = slid(lines.exit_per_length * (lines.exit_across * velocity), time)
    turning = lines.across * omega - lines.per_length * wp.cross(lines.cable, velocity)
    out.anchor = slid(turning, time)
    return out


@wp.func
def turn_since(start: BodyMotion, trial: BodyMotion) -> wp.vec3d:
    """Return by how much a platform turned in a time step [rad], to second order."""
    d = trial.rotation * wp.transpose(start.rotation)
    return wp.float64(0.5) * wp.vec3d(d[2, 1] - d[1, 2], d[0, 2] - d[2, 0], d[1, 0] - d[0, 1])


@wp.func
def rub(cable: Cable, bristles: Bristles, before: wp.vec3d, anchor: wp.vec3d, turn: wp.vec3d,
        size: wp.float64) -> Rubbing:  # fmt: skip
    """Return the dry friction of a cable at the end of a time step.

    The derivatives are for Newton steps: those of anchor friction leave out that a slip in one
    direction pulls at right angles to it, and that turns and motions of the anchor go together.

    Args:
        cable: The cable; see `rubs`.
        bristles: At the start of the step.
        before: Anchor point at the start of the step, in W [m].
        anchor: At its end.
        turn: Of the platform, as of `turn_since`.
        size: Typical length [m].
    """
    out = Rubbing()
    out.bristles = bristles
    way = anchor - before
    lines = lines_of(cable, anchor, size)
    if cable.exit_friction > ZERO:
        stiffness = cable.exit_friction / PRESLIDING_ANGLE * lines.exit_per_length
        z = lines.exit_across * bristles.exit
        slip = lines.exit_per_length * (lines.exit_across * way)
        found = bent(z, slip, lines.exit_across)
        out.bristles.exit = found.bend
        out.force = -stiffness * found.bend
        out.stiffness = (stiffness * lines.exit_per_length) * found.slope
    if cable.anchor_friction > ZERO:
        stiffness = cable.anchor_friction / PRESLIDING_ANGLE
        z = lines.across * bristles.anchor
        slip = lines.across * turn - lines.per_length * wp.cross(lines.cable, way)
        found = bent(z, slip, lines.across)
        out.bristles.anchor = found.bend
        pull = stiffness * lines.per_length
        out.force = out.force + pull * wp.cross(found.bend, lines.cable)
        out.stiffness = out.stiffness + (pull * lines.per_length) * found.slope
        out.moment = -stiffness * found.bend
        out.turning = stiffness * found.slope
    return out
