from dataclasses import replace

import numpy as np
import pytest

import carosac_toolkit as ct
from carosac_toolkit.recordings.bundled import find_recording
from carosac_toolkit.validation.plausibility import find_mix_ups

ROBOT = ct.load_robot("carosac")
RUN = ct.load_recording(find_recording("synthetic")).slice(200, 700)
LENGTHS = "Lengths are 1000 times the distance at the measured poses: are they in mm?"
XYZW = "The orientation fits if the quaternion is x y z w"


def mix_ups(recording, robot=ROBOT):
    found = recording.pose_at(recording.time)
    pose = ct.Pose(
        position=found.pose.position[found.valid], rotation=found.pose.rotation[found.valid]
    )
    return find_mix_ups(robot, recording.unstrained_length[found.valid], pose)


def changed(*, scale=1.0, order=(0, 1, 2, 3), position=1.0, shift=0.0, quaternion=(0, 1, 2, 3)):
    poses = RUN.poses
    return replace(
        RUN,
        unstrained_length=RUN.unstrained_length[:, list(order)] * scale,
        poses=replace(
            poses,
            position=poses.position * position + shift,
            quaternion=poses.quaternion[:, list(quaternion)],
        ),
    )


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({}, []),
        ({"scale": 1.04}, []),
        ({"scale": 1e3}, [LENGTHS]),
        ({"scale": 1e2}, ["Lengths are 100 times the distance", "are they in cm?"]),
        ({"position": 1e3}, ["Lengths and poses fit if the positions are in mm"]),
        ({"scale": 1e3, "position": 1e3}, [LENGTHS, "the positions are in mm"]),
        ({"order": (2, 1, 0, 3)}, ["measured length 1 fits exit point 3, 3 fits exit point 1."]),
        ({"order": (1, 2, 3, 0)}, ["length 1 fits exit point 2, 2 fits exit point 3, 3 fits exit"]),
        ({"quaternion": (1, 2, 3, 0)}, [XYZW]),
        ({"scale": (1.03, 0.97, 1.02, 0.98)}, []),
        ({"scale": 1e3, "order": (2, 1, 0, 3), "quaternion": (1, 2, 3, 0)},
         [LENGTHS, XYZW, "measured length 1 fits exit point 3, 3 fits exit point 1."]),
        ({"scale": 1.3}, ["Lengths are 1.3 times the distance", "check units"]),
        ({"scale": 1.2}, ["Lengths are 1.2 times the distance", "check units"]),
        ({"scale": 0.8}, ["Lengths are 0.8 times the distance", "check units"]),
        ({"scale": (1, 1.3, 1, 1)}, ["others fit: 2 (1.3", "their encoders and exit points"]),
        ({"shift": (3.0, 0.0, 0.0)}, ["the frame of the poses"]),
    ],
)  # fmt: skip
def test_each_mix_up_is_named_and_nothing_else(changes, said):
    text = " ".join(mix_ups(changed(**changes)))
    assert all(part in text for part in said)
    assert bool(text) == bool(said)
    assert ("swapped" in text) == ("order" in changes)
    assert ("quaternion" in text) == ("quaternion" in changes)


def test_wrong_zeros_of_a_still_platform_are_no_swap():
    position = np.tile(ROBOT.home_position, (40, 1))
    pose = ct.Pose(position=position, rotation=np.tile(np.eye(3), (40, 1, 1)))
    lengths = ct.straight_line.inverse_kinematics(ROBOT, position)
    order = np.argsort(lengths[0])
    middle = [order[1], order[2]]
    wrong = lengths.copy()
    wrong[:, middle] = lengths[:, middle[::-1]]
    difference = np.abs(wrong - lengths)[0].mean() / lengths.mean()
    said = " ".join(find_mix_ups(ROBOT, wrong, pose))
    assert ("swapped" in said) == (difference >= 0.03)
    assert find_mix_ups(ROBOT, lengths + np.array([0.1, -0.1, 0.05, 0.0]), pose) == ()


def test_lengths_outside_the_winch_range_are_named():
    short = replace(ROBOT, length_max=np.full(4, 5.0))
    assert "the winch of robot carosac has 1 to 5 m: is it this robot?" in mix_ups(RUN, short)[0]


def test_one_sample_is_enough_and_the_real_run_is_plausible(real_data):
    assert LENGTHS in mix_ups(changed(scale=1e3).slice(100, 101))
    run = ct.load_recording(real_data / "scampi_run_part.csv")
    assert mix_ups(run, ct.load_robot("scampi")) == ()


def test_the_result_carries_the_warnings():
    result = ct.validate(changed(scale=1e3).slice(0, 20), ROBOT, ["straight_line"])
    assert result.warnings == (LENGTHS,) and result.data()["warnings"] == (LENGTHS,)
