"""Records of a robot on a device: its cables and its platform, in float64 Warp."""

import warp as wp

wp.set_module_options({"enable_backward": False, "max_unroll": 1})


@wp.struct
class Cable:
    """One cable of a robot: geometry and material."""

    exit_point: wp.vec3d  # datum, in W [m]
    swivel_axis: wp.vec3d  # direction of travel into the pulley, in W
    anchor_point: wp.vec3d  # in P [m]
    pulley_radius: wp.float64  # [m]
    run_length: wp.float64  # [m]
    weight_per_length: wp.float64  # [N/m]
    axial_stiffness: wp.float64  # EA [N]
    axial_damping: wp.float64  # tension per strain rate [N s]
    exit_friction: wp.float64  # dry moment against turning of the cable at its exit [N m]
    anchor_friction: wp.float64  # the same against the platform at its anchor [N m]
    capstan_friction: wp.float64  # coefficient of the cable on its pulley or eyelet
    tension_min: wp.float64  # [N]
    tension_max: wp.float64  # [N]


@wp.struct
class StaticBody:
    """Platform with its payloads, as statics needs it."""

    weight: wp.float64  # [N]
    center_of_mass: wp.vec3d  # in P [m]
    arm: wp.float64  # typical lever of an anchor point [m], scales moments and rotations
    size: wp.float64  # typical cable length [m]


@wp.func
def anchor_of(cable: Cable, position: wp.vec3d, rotation: wp.mat33d) -> wp.vec3d:
    """Return the anchor point in W."""
    return position + rotation * cable.anchor_point
