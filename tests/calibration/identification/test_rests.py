"""Where a platform may rest by what is not known of the robot, against robots drawn from that."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import carosac_toolkit as ct
from benchmarks.calibration_oscillations import SURVEYED
from calibration.identification import procedure
from calibration.identification.rests import rest_doubt, rests_on
from calibration.identification.settings import IdentificationSettings
from calibration.identification.synthetic_oscillations import (
    OscillationSettings,
    simulate_oscillations,
)
from calibration.identification.unknowns import choose_coordinates
from carosac_toolkit.base.errors import CarosacError
from carosac_toolkit.loop.values import Pose
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.recordings.encoders import calibrated
from carosac_toolkit.recordings.poses import PoseSamples
from carosac_toolkit.recordings.recording import Recording
from carosac_toolkit.robot.parameters import turn_between, with_values
from carosac_toolkit.validation.pose_frames import find_frames

SHORT = OscillationSettings(count=2, duration=6.0, time_step=0.01)


@pytest.fixture(scope="module")
def robot():
    return ct.load_robot("carosac")


@pytest.fixture(scope="module")
def recording(robot):
    return simulate_oscillations(robot, 0, SHORT)[0]


def test_drawn_robots_rest_as_far_off_as_is_said(robot, recording):
    rng = np.random.default_rng(0)
    unknowns = choose_coordinates(robot, SURVEYED)
    rows = np.array([0, 100])
    reading = recording.unstrained_length[rows]
    slopes = rest_doubt(recording, unknowns, rows)
    here = statics.forward_kinematics(robot, reading)
    root = np.linalg.cholesky(unknowns.prior.covariance)
    off = []
    for _ in range(200):
        at = root @ rng.standard_normal(len(root))
        other = unknowns.robot_at(np.maximum(at, unknowns.lower))
        lengths = calibrated(recording, other).unstrained_length[rows]
        rest, back = statics.forward_kinematics(other, lengths), turn_between(other, robot)
        turn = Rotation.from_matrix(here.rotation.swapaxes(1, 2) @ back @ rest.rotation)
        off.append(np.hstack([rest.position @ back.T - here.position, turn.as_rotvec()]))
    said = np.sqrt((slopes**2).sum(axis=2))
    assert np.sqrt((np.array(off) ** 2).mean(axis=0)) == pytest.approx(said, rel=0.2)


def check(robot, recording):
    part = procedure._Part(
        name="run", recording=recording, train=(0, len(recording.time)), test=None
    )
    procedure._check(part, robot, choose_coordinates(robot, SURVEYED))


def test_a_centre_of_mass_within_what_is_known_does_not_refuse_a_robot(robot):
    """It moves the rest by more than zeros of lengths would, and turns the platform as well."""
    heavy = replace(robot, center_of_mass=robot.center_of_mass + np.array([0.045, 0.0, 0.0]))
    plant = with_values(heavy, ["pose_tilt.x", "pose_tilt.y"], np.array([0.0, -0.015]))
    run = simulate_oscillations(plant, 1, SHORT)[0]
    check(robot, run)
    names = ("center_of_mass.x", "center_of_mass.y", "center_of_mass.z")
    surveyed = replace(robot, calibrated=names, calibration_covariance=1e-8 * np.eye(3))
    with pytest.raises(CarosacError, match=r"Positions are 0\.\d+ m from where the lengths hold"):
        check(surveyed, run)


def test_another_tracked_point_is_named(robot, recording):
    poses = recording.poses
    moved = poses.position + np.array([0.0, 0.0, 0.2])
    other = replace(
        recording,
        poses=PoseSamples(time=poses.time, position=moved, quaternion=poses.quaternion),
    )
    with pytest.raises(CarosacError, match="Is the tracked point the origin of the platform frame"):
        check(robot, other)


def test_what_leaves_no_rest_changes_none(robot, recording, monkeypatch):
    """Nor does it turn the platform, whatever its attitude is."""
    unknowns = choose_coordinates(robot, SURVEYED)
    rows = np.array([0])
    before = rest_doubt(recording, unknowns, rows)
    solve, count = statics.forward_kinematics, []

    def fails_once(*args, **kwargs):
        count.append(1)
        found = solve(*args, **kwargs)
        return replace(found, converged=found.converged & (len(count) != 3))  # of the second step

    monkeypatch.setattr(statics, "forward_kinematics", fails_once)
    after = rest_doubt(recording, unknowns, rows)
    assert not after[:, :, 1].any()
    assert (np.delete(after, 1, axis=2) == np.delete(before, 1, axis=2)).all()


def test_robots_drawn_from_what_is_known_are_hardly_ever_refused(robot):
    """By chance one recording of 400, and more as rests move further than along a line."""
    rng = np.random.default_rng(1)
    unknowns = choose_coordinates(robot, IdentificationSettings())
    root, refused = np.linalg.cholesky(unknowns.prior.covariance), 0
    lengths = statics.inverse_kinematics(
        robot, robot.home_position + rng.uniform(-0.4, 0.4, (5, 3))
    ).unstrained_length
    still = Recording(time=np.arange(5.0), unstrained_length=lengths)
    for _ in range(60):
        plant = unknowns.robot_at(np.maximum(root @ rng.standard_normal(len(root)), unknowns.lower))
        position, rotation = rests_on(plant, calibrated(still, plant).unstrained_length)
        back = turn_between(plant, robot)
        pose = Pose(position=position @ back.T, rotation=back @ rotation)
        found = find_frames(
            robot, lengths, pose, zeros_known=False,
            doubt=lambda rows: rest_doubt(still, unknowns, rows),
        )  # fmt: skip
        refused += bool(found is not None and found.shift.any())
    assert refused <= 2
