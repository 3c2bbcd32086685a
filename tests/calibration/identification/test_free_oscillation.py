"""Identification from free oscillations alone: winches locked, swinging from the first sample."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import carosac_toolkit as ct
from calibration.identification.procedure import identify
from calibration.identification.settings import IdentificationSettings
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.physics.rest.modes import natural_frequencies
from carosac_toolkit.recordings.encoders import unstrained_lengths
from carosac_toolkit.recordings.poses import PoseSamples
from carosac_toolkit.robot.parameters import values_of
from tests.calibration.identification.oscillations import POSITION_NOISE_M, free_oscillation
from tests.robots import hanging

FEW = IdentificationSettings(
    exit_points=0.0, anchor_points=0.0, length_scale=0.0, length_delay=0.0, mass=0.0,
    linear_density=0.0, axial_stiffness=0.0, axial_damping=0.0, run_length=0.0,
)  # fmt: skip  # what remains: offsets, centre of mass, inertia, both drags


@pytest.mark.parametrize("plant", [ct.load_robot("carosac"), hanging(3)], ids=["four", "three"])
def test_a_swinging_platform_tells_its_frequencies_and_its_centre_of_mass(plant):
    """The robot file is off by 2 cm in the centre of mass, 20 % in inertia, and in drag."""
    recording, _ = free_oscillation(plant, 1, swing=np.radians(12.0), duration=12.0)
    wrong = replace(
        plant, center_of_mass=plant.center_of_mass + np.array([0.012, -0.011, 0.011]),
        inertia=1.2 * plant.inertia, drag=1.5 * plant.drag, angular_drag=2.0 * plant.angular_drag,
    )  # fmt: skip
    count = len(recording.time)
    found = identify(recording, wrong, FEW, train=(0, 2 * count // 3), test=(2 * count // 3, count))
    assert found.warnings == () and found.converged
    assert found.first_motion.moves
    assert found.test.after.rmse[3] < 1.3 * np.sqrt(3.0) * POSITION_NOISE_M
    assert not found.against_mean.useless and found.against_mean.spread > 0.01
    readings = recording.unstrained_length.mean(axis=0, keepdims=True)
    frequency = [
        natural_frequencies(robot, statics.forward_kinematics(robot, lengths))[0, : 6 - plant.n]
        for robot, lengths in (
            (plant, readings), (found.robot, unstrained_lengths(found.robot, readings)),
        )
    ]  # fmt: skip
    assert frequency[1] == pytest.approx(frequency[0], rel=5e-3)
    sigma = found.estimate.select([f"center_of_mass.{axis}" for axis in "xyz"]).sigma
    off = np.abs(found.robot.center_of_mass - plant.center_of_mass)
    assert (off < np.maximum(2e-3, 2.0 * sigma)).all()


def test_dry_friction_and_the_tilt_of_the_pose_frame_are_found_from_a_swing():
    """Exit points are in the tilted frame too. Centre and offsets, which act alike, are held."""
    bare = ct.load_robot("carosac")
    plant = replace(bare, anchor_friction=np.full(4, 0.15), angular_drag=0.5 * bare.angular_drag)
    level, _ = free_oscillation(plant, 3, swing=np.radians(15.0), duration=20.0)
    tilt = Rotation.from_rotvec([0.006, -0.008, 0.0]).as_matrix()  # from the poses' frame to W
    tilted = PoseSamples.from_rotation(
        level.poses.time, level.poses.position @ tilt,
        tilt.T @ Rotation.from_quat(level.poses.quaternion, scalar_first=True).as_matrix(),
    )  # fmt: skip
    robot = replace(bare, exit_points=plant.exit_points @ tilt)
    settings = replace(
        FEW, exit_points=1e-4, length_hysteresis=0.0, length_offset=0.0, exit_friction=0.0,
        center_of_mass=0.0,
    )  # fmt: skip
    count = len(level.time)
    found = identify(
        replace(level, poses=tilted), robot, settings, train=(0, 3 * count // 4),
        test=(3 * count // 4, count),
    )  # fmt: skip
    assert found.test.after.rmse[3] < 1.3 * np.sqrt(3.0) * POSITION_NOISE_M
    assert (found.estimate.covariance == found.estimate.covariance.T).all()
    assert found.robot.anchor_friction == pytest.approx(np.full(4, 0.15), rel=0.2)
    assert values_of(found.robot, ["pose_tilt.x", "pose_tilt.y"]) == pytest.approx(
        [0.006, -0.008], abs=1e-3
    )
    assert found.robot.exit_points == pytest.approx(plant.exit_points, abs=0.01)
