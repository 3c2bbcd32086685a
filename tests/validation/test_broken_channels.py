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
        (2.5, "others fit: 3 (2.5 times)."),
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


def without(run, begin, end):
    """The run without poses for some time."""
    poses = run.poses
    kept = (poses.time < begin) | (poses.time > end)
    return replace(
        run,
        poses=PoseSamples(
            time=poses.time[kept], position=poses.position[kept], quaternion=poses.quaternion[kept]
        ),
    )


def test_a_drum_that_errs_over_a_gap_of_the_poses_is_no_slip():
    def drum(length):
        length[:, 1] = length[0, 1] + 1.02 * (length[:, 1] - length[0, 1])

    assert "jumps" not in text_of(wound(without(RUN, 85.0, 89.0), drum))


def test_a_tracker_that_holds_every_pose_for_a_second_did_not_lose_the_platform():
    time = RUN.poses.time
    row = np.searchsorted(time, time[0] + 1.05 * np.floor((time - time[0]) / 1.05))

    def hold(position, quaternion):
        position[:], quaternion[:] = position[row], quaternion[row]

    assert "is repeated" not in text_of(posed(RUN, hold))


def recording_of(robot, length, position, rotation):
    time = 0.05 * np.arange(len(length))
    poses = PoseSamples.from_rotation(time, position, rotation)
    return ct.Recording(time=time, unstrained_length=length, poses=poses)


@pytest.mark.parametrize(("name", "cable"), [("ipanema1", 4), ("hangprinter", 0)])
def test_a_slack_cable_that_is_paid_out_neither_slips_nor_freezes_the_tracker(name, cable):
    """It winds without moving the platform by what a tracker sees, here a millimetre."""
    robot = ct.load_robot(name)
    start = robot.home_position + np.array([0.0, 0.0, 0.15 if name == "hangprinter" else 0.0])
    length = np.tile(ct.statics.inverse_kinematics(robot, start[None]).unstrained_length, (400, 1))
    length[100:, cable] += np.minimum(0.06, 0.015 * np.arange(300))
    rest = ct.statics.forward_kinematics(robot, length)
    assert rest.converged.all()
    position = rest.position.round(3)
    rotation = np.tile(robot.home_rotation, (400, 1, 1))
    said = text_of(recording_of(robot, length, position, rotation), robot)
    assert "jumps" not in said and "is repeated" not in said


def test_eight_cables_hold_an_attitude_which_needs_not_change():
    robot, rng = ct.load_robot("ipanema1"), np.random.default_rng(0)
    position = robot.home_position + 0.2 * rng.uniform(-1.0, 1.0, (80, 3))
    length = ct.statics.inverse_kinematics(robot, position).unstrained_length
    length = length + 1e-3 * rng.standard_normal(length.shape)
    rotation = np.tile(robot.home_rotation, (80, 1, 1))
    assert "not measured" not in text_of(recording_of(robot, length, position, rotation), robot)


def test_lengths_that_hang_from_one_slack_cable_to_another_do_not_slip():
    """Inverse kinematics of a hangprinter goes between solutions with one cable nearly slack."""
    robot, rng = ct.load_robot("hangprinter"), np.random.default_rng(0)
    for _ in range(8):
        ends = robot.home_position + 0.3 * rng.uniform(-1.0, 1.0, (2, 3)) + [0.0, 0.0, 0.3]
        path = ends[0] + np.linspace(0.0, 1.0, 60)[:, None] * (ends[1] - ends[0])
        rest = ct.statics.inverse_kinematics(robot, path)
        good = rest.converged
        said = text_of(
            recording_of(robot, rest.unstrained_length[good], path[good], rest.rotation[good]),
            robot,
        )
        assert "jumps" not in said and "another factor" not in said
