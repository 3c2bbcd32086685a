"""From a checked robot file to the arrays of a `Robot`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.robot.hardware import AdsAddress, Hardware, ImuSource
from carosac_toolkit.robot.model_error import ModelError
from carosac_toolkit.robot.robot import RigidBody, Robot, combine_bodies

if TYPE_CHECKING:
    from carosac_toolkit.robot.schema import (
        ChainInput,
        ExitPoint,
        Home,
        Payload,
        Platform,
        RobotFile,
        TensionLimits,
    )


def build_robot(file: RobotFile) -> Robot:
    """Assemble the robot; the file has no faults any more."""
    chains = file.chains
    exits = [file.frame.exit_points[chain.exit_point] for chain in chains]
    anchors = [file.platform.anchor_points[chain.anchor_point] for chain in chains]
    cables = [file.cable_types[chain.cable] for chain in chains]
    winches = [file.winches[chain.winch] for chain in chains]
    limits = [_limits(chain, file) for chain in chains]
    drums = [winch.drum for winch in winches if winch.drum is not None]
    body = _body(file)
    lower, upper = file.workspace.corners
    return Robot(
        name=file.name,
        cable_names=tuple(chain.name for chain in chains),
        exit_points=np.array([point.position for point in exits]),
        exit_covariance=_covariance(exits),
        pulley_radius=np.array([point.pulley.radius if point.pulley else 0.0 for point in exits]),
        swivel_axis=np.array(
            [point.pulley.swivel_axis if point.pulley else (0.0, 0.0, -1.0) for point in exits]
        ),
        run_length=np.array(
            [
                winch.run_length if chain.run_length is None else chain.run_length
                for chain, winch in zip(chains, winches, strict=True)
            ]
        ),
        anchor_points=np.array(anchors),
        linear_density=np.array([cable.linear_density for cable in cables]),
        axial_stiffness=np.array([cable.stiffness for cable in cables]),
        axial_damping=np.array([cable.axial_damping for cable in cables]),
        exit_friction=np.array([cable.exit_friction for cable in cables]),
        anchor_friction=np.array([cable.anchor_friction for cable in cables]),
        capstan_friction=np.array([cable.capstan_friction for cable in cables]),
        length_hysteresis=np.array([winch.length_hysteresis for winch in winches]),
        cable_diameter=np.array([cable.diameter for cable in cables]),
        tension_min=np.array([limit.min for limit in limits]),
        tension_max=np.array([limit.max for limit in limits]),
        speed_max=np.array([winch.speed_max for winch in winches]),
        acceleration_max=np.array([winch.acceleration_max for winch in winches]),
        winch_lag=np.array([winch.lag for winch in winches]),
        length_min=np.array([winch.length_min for winch in winches]),
        length_max=np.array([winch.length_max for winch in winches]),
        drum_radius=np.array([drum.radius for drum in drums]) if drums else None,
        drum_buildup=np.array([drum.buildup for drum in drums]) if drums else None,
        drum_gear=_known([drum.gear for drum in drums]),
        drum_advantage=np.array([drum.advantage or 1.0 for drum in drums]) if drums else None,
        mass=body.mass,
        center_of_mass=body.center_of_mass,
        inertia=body.inertia,
        drag=file.platform.air_drag.linear,
        angular_drag=file.platform.air_drag.angular,
        angular_drag_axes=np.array(file.platform.air_drag.angular_axes),
        cable_drag=file.platform.air_drag.cables,
        gravity=file.gravity,
        workspace_min=np.array(lower),
        workspace_max=np.array(upper),
        home_position=np.array(file.home.position),
        home_rotation=home_rotation(file.home),
        description=file.description,
        licence=file.licence,
        provenance=dict(file.provenance),
        model_error=(
            None if file.model_error is None else ModelError(**file.model_error.model_dump())
        ),
        hardware=_hardware(file),
        **_calibration(file),
    )


def home_rotation(home: Home) -> Array:
    """Return the rotation from P to W at home, shape (3, 3); identity if the file states none."""
    if home.quaternion_wxyz is not None:
        return _rotation(home.quaternion_wxyz)
    roll, pitch, yaw = np.radians(home.rpy_deg or (0.0, 0.0, 0.0))
    about_x = np.array(
        [[1.0, 0, 0], [0, np.cos(roll), -np.sin(roll)], [0, np.sin(roll), np.cos(roll)]]
    )
    about_y = np.array(
        [[np.cos(pitch), 0, np.sin(pitch)], [0, 1.0, 0], [-np.sin(pitch), 0, np.cos(pitch)]]
    )
    about_z = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1.0]])
    rotation: Array = about_z @ about_y @ about_x
    return rotation


def _rotation(quaternion: list[float]) -> Array:
    """Return the rotation matrix of a unit quaternion w, x, y, z."""
    w, x, y, z = quaternion
    vector = np.array([x, y, z])
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    turned: Array = np.outer(vector, vector) + w * cross
    return (w * w - float(vector @ vector)) * np.eye(3) + 2.0 * turned


def _calibration(file: RobotFile) -> dict[str, Any]:
    """Return the fields that a calibration filled in."""
    calibrated: dict[str, Any] = {}
    sensors = file.sensors
    if sensors is not None and sensors.lengths is not None:
        cables = [sensors.lengths.cables[chain.name] for chain in file.chains]
        calibrated |= {
            "length_offset": np.array([cable.offset for cable in cables]),
            "length_scale": np.array([cable.scale for cable in cables]),
            "length_delay": sensors.lengths.delay,
        }
    if sensors is not None and sensors.poses is not None:
        calibrated["pose_rotation"] = _rotation(sensors.poses.quaternion_wxyz)
    if file.calibration is not None:
        lower = np.zeros((len(file.calibration.parameters),) * 2)
        for i, row in enumerate(file.calibration.covariance):
            lower[i, : i + 1] = row
        calibrated["calibrated"] = tuple(file.calibration.parameters)
        calibrated["calibration_covariance"] = lower + np.tril(lower, -1).T
    return calibrated


def _hardware(file: RobotFile) -> Hardware | None:
    """Return the PLC, or None if the file has none."""
    section = file.hardware
    if section is None:
        return None
    cables = [section.cables[chain.name] for chain in file.chains]
    return Hardware(
        sign=tuple(cable.sign for cable in cables),
        scale=tuple(cable.scale for cable in cables),
        offset=tuple(cable.offset for cable in cables),
        ads=AdsAddress(**section.ads.model_dump()),
        imu=None if section.imu is None else ImuSource(**section.imu.model_dump()),
    )


def _known(values: list[float | None]) -> Array | None:
    """Return an array, or None if any entry is missing."""
    known = [value for value in values if value is not None]
    return np.array(known) if known and len(known) == len(values) else None


def _body(file: RobotFile) -> RigidBody:
    """Combine platform and payloads."""
    parts: list[Platform | Payload] = [file.platform, *file.platform.payloads]
    return combine_bodies(
        RigidBody(part.mass, np.array(part.center_of_mass), np.array(part.inertia))
        for part in parts
    )


def _limits(chain: ChainInput, file: RobotFile) -> TensionLimits:
    """Return the tension limits of a chain: its own, else those of all."""
    limits = chain.tension_limits or file.tension_limits
    assert limits is not None  # robot_checks asks for one of them
    return limits


def _covariance(exits: list[ExitPoint]) -> Array | None:
    """Return covariances of the exit points [m^2], shape (n, 3, 3); None if the file has none."""
    rows = []
    for point in exits:
        if point.covariance is not None:
            rows.append(np.array(point.covariance))
        elif point.sigma is not None:
            rows.append(np.diag(np.square(point.sigma)))
    return np.array(rows) if rows else None
