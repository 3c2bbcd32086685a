from __future__ import annotations

from dataclasses import replace
from importlib.resources import files

import numpy as np
import pytest

import carosac_toolkit as ct
from calibration.estimate import ParameterEstimate
from calibration.robot_update import (
    check_output,
    prior_covariance,
    updated,
    write_robot,
)
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.robot.differences import differing
from carosac_toolkit.robot.file import robot_text
from carosac_toolkit.robot.parameters import values_of

ROBOT = ct.load_robot("carosac")
POINTS = tuple(f"exit_points[{cable}].{axis}" for cable in ROBOT.cable_names for axis in "xyz")
SOURCE = "calibrated on a Sunday"


def estimate(names, *, seed=0, by=0.01, robot=ROBOT):
    rng = np.random.default_rng(seed)
    start = values_of(robot, names)
    root = rng.normal(0.0, 1e-3, (len(names), len(names)))
    return ParameterEstimate(
        names=tuple(names),
        value=start + by,
        covariance=root @ root.T + 1e-8 * np.eye(len(names)),
        start=start,
        prior_sigma=np.full(len(names), 0.05),
    )


def test_values_and_what_is_known_of_them_reach_the_robot():
    found = estimate([*POINTS, "mass", "length_offset[front_left]"])
    robot = updated(ROBOT, found)
    assert robot.exit_points == pytest.approx(ROBOT.exit_points + 0.01)
    assert robot.mass == pytest.approx(ROBOT.mass + 0.01)
    assert robot.length_offset.tolist() == pytest.approx([0.01, 0.0, 0.0, 0.0])
    assert robot.calibrated == found.names
    assert robot.calibration_covariance == pytest.approx(found.covariance)
    for i in range(4):
        block = slice(3 * i, 3 * i + 3)
        assert robot.exit_covariance[i] == pytest.approx(found.covariance[block, block])


def test_an_earlier_calibration_stays_where_it_is_not_repeated():
    first = updated(ROBOT, estimate([*POINTS, "mass"]))
    later = estimate(["length_delay", "mass"], seed=1, robot=first)
    robot = updated(first, later)
    assert robot.calibrated == ("length_delay", "mass", *POINTS)
    assert robot.calibration_covariance[:2, :2] == pytest.approx(later.covariance)
    assert robot.calibration_covariance[2:, 2:] == pytest.approx(
        first.calibration_covariance[:12, :12]
    )
    assert not robot.calibration_covariance[:2, 2:].any()
    assert np.array_equal(robot.exit_points, first.exit_points)
    assert robot.exit_covariance == pytest.approx(first.exit_covariance)


def test_points_that_were_not_estimated_keep_their_covariance():
    known = replace(ROBOT, exit_covariance=np.tile(4e-6 * np.eye(3), (4, 1, 1)))
    robot = updated(known, estimate(POINTS[:3]))
    assert robot.exit_covariance[1:] == pytest.approx(known.exit_covariance[1:])
    assert robot.exit_covariance[0] == pytest.approx(estimate(POINTS[:3]).covariance)
    assert updated(ROBOT, estimate(POINTS[:3])).exit_covariance is None  # of all, or of none


def test_what_is_known_before_is_the_calibration_then_the_exit_points_then_the_default():
    names = (*POINTS[:3], "mass", "drag")
    sigma = np.full(5, 0.5)
    assert prior_covariance(ROBOT, names, sigma) == pytest.approx(0.25 * np.eye(5))
    block = np.array([[4.0, 1.0, 0.0], [1.0, 4.0, 0.5], [0.0, 0.5, 4.0]]) * 1e-6
    surveyed = replace(ROBOT, exit_covariance=np.tile(block, (4, 1, 1)))
    found = prior_covariance(surveyed, names, sigma)
    assert found[:3, :3] == pytest.approx(block)
    assert found[3:, 3:] == pytest.approx(0.25 * np.eye(2))
    joint = estimate([POINTS[0], "mass"])
    calibrated = replace(surveyed, calibrated=joint.names, calibration_covariance=joint.covariance)
    found = prior_covariance(calibrated, names, sigma)
    assert found[np.ix_([0, 3], [0, 3])] == pytest.approx(joint.covariance)
    assert found[1:3, 1:3] == pytest.approx(block[1:, 1:])  # not calibrated
    assert not found[0, 1:3].any() and not found[0, 4]
    assert np.linalg.eigvalsh(found)[0] > 0.0


def test_prior_follows_the_order_of_the_names():
    block = np.diag([1.0, 2.0, 3.0]) * 1e-6
    surveyed = replace(ROBOT, exit_covariance=np.tile(block, (4, 1, 1)))
    found = prior_covariance(surveyed, (POINTS[2], "mass", POINTS[0]), np.ones(3))
    assert np.diag(found) == pytest.approx([3e-6, 1.0, 1e-6])


def test_the_new_file_is_the_updated_robot_and_the_old_one_stays(tmp_path):
    old, new = tmp_path / "old.yaml", tmp_path / "new.yaml"
    old.write_text(robot_text("carosac"))
    found = estimate([*POINTS, "pose_tilt.x", "pose_tilt.y", "length_scale[rear_left]"], by=1e-3)
    robot = write_robot(str(old), found, new, provenance=SOURCE, name="sunday")
    assert old.read_text() == robot_text("carosac")
    back = ct.load_robot(new)
    assert back.name == robot.name == "sunday"
    assert differing(back, robot) == ["provenance"]
    assert back.provenance["frame.exit_points"] == SOURCE
    assert back.provenance["calibration"] == back.provenance["sensors.poses"] == SOURCE
    assert differing(robot, replace(updated(ROBOT, found), name="sunday")) == []
    assert sorted(path.name for path in tmp_path.iterdir()) == ["new.yaml", "old.yaml"]


def test_points_that_nobody_measured_keep_their_source(tmp_path):
    found = estimate([*POINTS[:3], "anchor_points[rear_left].x"], by=1e-3)
    robot = write_robot("carosac", found, tmp_path / "x.yaml", provenance=SOURCE)
    sources = ct.load_robot(tmp_path / "x.yaml").provenance
    assert sources["frame.exit_points"] == sources["platform.anchor_points"] == SOURCE
    for i, cable in enumerate(ROBOT.cable_names):
        old = ROBOT.provenance["frame.exit_points"]
        moved = np.any(robot.exit_points[i] != ROBOT.exit_points[i])
        assert sources.get(f"frame.exit_points.{cable}", SOURCE) == (SOURCE if moved else old)


def test_a_bundled_robot_keeps_its_name_unless_it_gets_another(tmp_path):
    robot = write_robot("carosac", estimate(["mass"]), tmp_path / "x.yaml", provenance=SOURCE)
    assert robot.name == ct.load_robot(tmp_path / "x.yaml").name == "carosac"


@pytest.mark.parametrize("way", ["itself", "symlink", "hard link", "other spelling"])
def test_the_old_file_is_never_overwritten(tmp_path, way):
    old, output = tmp_path / "old.yaml", tmp_path / "link.yaml"
    old.write_text(robot_text("carosac"))
    if way == "symlink":
        output.symlink_to(old)
    elif way == "hard link":
        output.hardlink_to(old)
    else:
        output = old if way == "itself" else tmp_path / ".." / tmp_path.name / "old.yaml"
    message = "output: got .*; allowed: a new file: the robot file that was calibrated is never"
    with pytest.raises(InvalidField, match=message):
        write_robot(str(old), estimate(["mass"]), output, provenance=SOURCE)
    assert old.read_text() == robot_text("carosac")


def test_the_file_of_a_bundled_robot_is_never_overwritten():
    bundled = files("carosac_toolkit.robot") / "bundled" / "carosac.yaml"
    with pytest.raises(InvalidField, match="never overwritten"):
        check_output("--output", bundled, "carosac")


def test_another_file_that_is_there_is_replaced(tmp_path):
    (tmp_path / "x.yaml").write_text("an earlier result")
    check_output("--output", tmp_path / "x.yaml", "carosac")
    check_output("--output", None, "carosac")
    with pytest.raises(InvalidField, match=r"--output: .*ending in .yaml or .yml"):
        check_output("--output", tmp_path / "x.json", "carosac")


def test_a_value_that_no_robot_can_have_writes_nothing(tmp_path):
    with pytest.raises(InvalidField, match="mass: got"):
        write_robot("carosac", estimate(["mass"], by=-50.0), tmp_path / "x.yaml", provenance=SOURCE)
    assert list(tmp_path.iterdir()) == []
