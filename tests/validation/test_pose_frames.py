from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import carosac_toolkit as ct
from carosac_toolkit.recordings.bundled import find_recording
from carosac_toolkit.recordings.poses import PoseSamples
from carosac_toolkit.validation.plausibility import find_misfits
from carosac_toolkit.validation.pose_frames import find_frames

ROBOT = ct.load_robot("carosac")
RUN = ct.load_recording(find_recording("synthetic"))


def turn(axis, degrees):
    return Rotation.from_euler(axis, degrees, degrees=True).as_matrix()


def seen(run, *, body=None, point=(0.0, 0.0, 0.0), world=None, shift=(0.0, 0.0, 0.0)):
    """Poses of another body, or of another point of it, in another world frame."""
    body, world = (np.eye(3) if each is None else each for each in (body, world))
    poses = run.poses
    position = (poses.position + poses.rotation @ np.asarray(point)) @ world.T + shift
    turned = world @ poses.rotation @ body
    return replace(run, poses=PoseSamples.from_rotation(poses.time, position, turned))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({}, ""),
        ({"shift": (0.05, 0.0, 0.0)}, ""),
        ({"body": turn("z", 5)}, ""),
        ({"body": turn("z", 90)}, "platform frame of robot {}: orientations fit once turned by -9"),
        ({"body": turn("x", 90)}, "platform frame of robot {}: orientations fit once turned by -9"),
        ({"body": turn("x", 90)}, "degrees about x of the tracked body"),
        ({"world": turn("z", 90)}, "turned against W of robot {}: they fit once turned by -90"),
        ({"world": turn("z", 180)}, "180 degrees about z of W"),
        ({"world": turn("z", -15)}, "once turned by 15 degrees about z of W"),
        ({"world": turn("x", 90)}, "once turned by -90 degrees about x of W"),
        ({"world": turn("x", 90), "body": turn("z", -90)}, "about z of the tracked body"),
        ({"shift": (1.0, 0.0, 0.0)}, "the lengths hold the platform: they fit once moved by (-"),
        ({"point": (0.0, 0.0, 0.25)}, "Is the tracked point the origin of the platform frame"),
        ({"world": turn("z", 90), "shift": (0.0, 1.0, 0.0)}, "then moved by ("),
    ],
)  # fmt: skip
@pytest.mark.parametrize("name", ["carosac", "scampi"])
def test_each_frame_is_named_and_nothing_else(name, change, said, request):
    run, robot = RUN, ROBOT
    if name == "scampi":
        data = request.getfixturevalue("real_data")
        run, robot = ct.load_recording(data / "scampi_run_part.csv"), ct.load_robot("scampi")
    text = " ".join(find_misfits(seen(run, **change), robot))
    assert said.format(name) in text
    assert bool(text) == bool(said)


@pytest.mark.parametrize("axis", [[1.0, 0.0, 0.0], [1.0, 1.0, 0.0]])
@pytest.mark.parametrize("degrees", [0, 90])
def test_a_straight_line_tells_the_turn_that_its_attitudes_tell_or_none(axis, degrees):
    line = ROBOT.home_position + np.linspace(-0.6, 0.6, 100)[:, None] * axis
    rest = ct.statics.inverse_kinematics(ROBOT, line)
    world = turn("z", degrees)
    noise = 1e-3 * np.random.default_rng(0).standard_normal(line.shape)
    pose = ct.Pose(position=line @ world.T + noise, rotation=world @ rest.rotation)
    found = find_frames(ROBOT, rest.unstrained_length, pose)
    np.testing.assert_allclose(found.world_turn, world.T, atol=0.02)
    np.testing.assert_array_equal(found.body_turn, np.eye(3))
    other = replace(pose, rotation=pose.rotation @ turn("z", 50))
    unknown = find_frames(ROBOT, rest.unstrained_length, other)
    np.testing.assert_array_equal(unknown.world_turn, np.eye(3))


def test_half_a_turn_about_z_looks_like_another_order_of_quaternions_and_both_are_named():
    text = find_misfits(seen(RUN, body=turn("z", 180)), ROBOT)
    assert "x y z w" in text[0] and text[1].startswith("Otherwise: The tracked body")


ALONG_X = np.zeros((6, 1))
ALONG_X[0] = 0.1  # [m], one sigma of where the platform rests


@pytest.mark.parametrize(
    ("shift", "doubt", "named"),
    [
        ((0.18, 0.0, 0.0), None, True),
        ((0.18, 0.0, 0.0), ALONG_X, False),
        ((0.45, 0.0, 0.0), ALONG_X, True),
        ((0.0, 0.18, 0.0), ALONG_X, True),
        ((0.05, 0.0, 0.0), 0.0 * ALONG_X, False),
    ],
)
def test_a_platform_may_rest_where_what_is_not_known_of_the_robot_moves_it(shift, doubt, named):
    rest = ct.statics.inverse_kinematics(ROBOT, ROBOT.home_position + np.zeros((20, 1)))
    pose = ct.Pose(position=ROBOT.home_position + np.array([shift] * 20), rotation=rest.rotation)
    asked = None if doubt is None else (lambda rows: np.tile(doubt, (len(rows), 1, 1)))
    found = find_frames(ROBOT, rest.unstrained_length, pose, doubt=asked)
    assert found.shift == pytest.approx(-np.array(shift) if named else np.zeros(3), abs=1e-3)


def test_what_would_turn_the_platform_too_is_no_excuse_where_it_is_not_turned():
    rest = ct.statics.inverse_kinematics(ROBOT, ROBOT.home_position + np.zeros((20, 1)))
    moved = ROBOT.home_position + np.tile([0.18, 0.0, 0.0], (20, 1))
    doubt = ALONG_X.copy()
    doubt[4] = 0.2  # [rad]
    found = [
        find_frames(
            ROBOT, rest.unstrained_length, ct.Pose(position=moved, rotation=rest.rotation @ turned),
            zeros_known=False, doubt=lambda rows: np.tile(doubt, (len(rows), 1, 1)),
        ).shift.any()
        for turned in (np.eye(3), Rotation.from_rotvec([0.0, 0.36, 0.0]).as_matrix())
    ]  # fmt: skip
    assert found == [True, False]
