from dataclasses import replace

import numpy as np
import pytest

import carosac_toolkit as ct
from carosac_toolkit.recordings.bundled import find_recording
from carosac_toolkit.recordings.poses import PoseSamples
from carosac_toolkit.validation.plausibility import find_misfits

ROBOT = ct.load_robot("carosac")
RUN = ct.load_recording(find_recording("synthetic"))


def text_of(run, robot=ROBOT):
    return " ".join(find_misfits(run, robot))


def posed(run, change):
    """The run with positions and quaternions changed in place."""
    position, quaternion = np.array(run.poses.position), np.array(run.poses.quaternion)
    change(position, quaternion)
    return replace(
        run, poses=PoseSamples(time=run.poses.time, position=position, quaternion=quaternion)
    )


def wound(run, change):
    """The run with lengths changed in place."""
    length = np.array(run.unstrained_length)
    change(length)
    return replace(run, unstrained_length=length)


def moving(run, seconds):
    """First pose of a time in which the platform goes far."""
    time = run.poses.time
    last = np.searchsorted(time, time + seconds)
    ends = np.minimum(last, len(time) - 1)
    return int(np.linalg.norm(run.poses.position[ends] - run.poses.position, axis=1).argmax())


@pytest.mark.parametrize(("seconds", "named"), [(3.0, True), (0.5, False)])
def test_a_tracker_that_repeats_a_pose_while_cables_are_wound_is_named(seconds, named):
    start = moving(RUN, 3.0)
    end = int(np.searchsorted(RUN.poses.time, RUN.poses.time[start] + seconds))

    def freeze(position, quaternion):
        position[start:end], quaternion[start:end] = position[start], quaternion[start]

    said = text_of(posed(RUN, freeze))
    assert (f"Pose {start + 1} is repeated from {RUN.poses.time[start]:.2f} s to" in said) == named


def test_a_platform_that_stands_still_may_have_one_pose():
    still = RUN.slice(0, 50)
    first = [still.poses.position[0], still.poses.quaternion[0]]

    def freeze(position, quaternion):
        position[:], quaternion[:] = first

    held = wound(posed(still, freeze), lambda length: np.copyto(length, length[0]))
    assert text_of(held) == ""


@pytest.mark.parametrize(("slip", "named"), [(0.2, True), (-0.12, True), (0.02, False)])
def test_a_cable_that_slips_is_named(slip, named):
    def slips(length):
        length[300:, 1] += slip

    said = text_of(wound(RUN, slips))
    assert said.startswith(f"Length 2 jumps by {abs(slip):.2g} m against") == named
    assert bool(said) == named


def test_one_wrong_reading_is_no_slip():
    def spike(length):
        length[300, 1] += 0.3

    assert text_of(wound(RUN, spike)) == ""


@pytest.mark.parametrize(
    ("ratio", "said"),
    [
        (3.281, "others fit: 3 (3.28 times, as in feet)."),
        (1.5, "others fit: 3 (1.5 times)."),
        (1.03, ""),
    ],
)
def test_one_length_in_another_unit_is_named(ratio, said):
    """As where its zero is right in the middle: nothing but its changes tells that."""

    def scaled(length):
        length[:, 2] = length[:, 2].mean() + ratio * (length[:, 2] - length[:, 2].mean())

    found = text_of(wound(RUN, scaled))
    assert said in found and bool(said) == bool(found)


def test_an_orientation_that_was_not_measured_is_named():
    def same(_, quaternion):
        quaternion[:] = quaternion[0]

    assert "it was not measured" in text_of(posed(RUN, same))


def test_inverse_orientations_and_inverse_poses_of_a_real_robot_are_named(real_data):
    run, robot = ct.load_recording(real_data / "scampi_run_part.csv"), ct.load_robot("scampi")

    def inverse(_, quaternion):
        quaternion[:, 1:] *= -1.0

    assert text_of(posed(run, inverse), robot).startswith("Orientations fit once inverted")
    turned = run.poses.rotation.swapaxes(1, 2)
    back = -np.einsum("sij,sj->si", turned, run.poses.position)
    poses = PoseSamples.from_rotation(run.poses.time, back, turned)
    assert text_of(replace(run, poses=poses), robot).startswith("Poses fit once inverted")


@pytest.mark.parametrize(
    ("order", "signs", "said"),
    [((1, 0, 2), (1, 1, 1), "(y, x, z)"), ((0, 1, 2), (1, -1, 1), "(x, -y, z)")],
)
def test_axes_that_mirror_space_are_named(order, signs, said):
    def mirrored(position, _):
        position[:] = position[:, list(order)] * signs

    assert f"Positions fit if {said} of the measured ones" in text_of(posed(RUN, mirrored))
