from dataclasses import replace

import numpy as np
import pytest

import carosac_toolkit as ct
from carosac_toolkit.base.errors import MissingFile
from carosac_toolkit.robot.model_error import ModelError
from carosac_toolkit.robot.robot import RigidBody, combine_bodies
from tests.robots import simple_robot


def rod(mass, length, center):
    inertia = np.diag([0.0, 1.0, 1.0]) * mass * length**2 / 12.0
    return RigidBody(mass, np.asarray(center, dtype=float), inertia)


def test_two_half_rods_are_one_rod():
    whole = rod(3.0, 2.0, [0.4, 0.0, 0.1])
    halves = combine_bodies([rod(1.5, 1.0, [-0.1, 0.0, 0.1]), rod(1.5, 1.0, [0.9, 0.0, 0.1])])
    assert halves.mass == pytest.approx(whole.mass)
    assert halves.center_of_mass == pytest.approx(whole.center_of_mass)
    assert halves.inertia == pytest.approx(whole.inertia, abs=1e-15)


def test_combined_bodies_keep_the_moment_of_inertia_about_any_point():
    rng = np.random.default_rng(3)
    bodies = []
    for _ in range(4):
        points = rng.normal(size=(20, 3))
        mass = rng.uniform(0.1, 1.0, 20)
        parts = [RigidBody(m, p, np.zeros((3, 3))) for m, p in zip(mass, points, strict=True)]
        bodies.append((combine_bodies(parts), mass, points))
    total = combine_bodies([body for body, _, _ in bodies])
    mass = np.concatenate([m for _, m, _ in bodies])
    arms = np.concatenate([p for _, _, p in bodies]) - total.center_of_mass
    expected = np.einsum(
        "i,ijk->jk",
        mass,
        np.einsum("ij,ij->i", arms, arms)[:, None, None] * np.eye(3)
        - arms[:, :, None] * arms[:, None, :],
    )
    assert mass @ arms == pytest.approx(np.zeros(3), abs=1e-12)
    assert total.inertia == pytest.approx(expected)


@pytest.mark.parametrize("name", ["carosac", "cogiro"])
def test_npz_carries_a_robot_without_loss(tmp_path, name):
    error = ModelError(
        mass=0.02, length=1e-3, force=0.1, acceleration=2e-3, position=3e-3, rotation=4e-3
    )
    robot = replace(ct.load_robot(name), model_error=error)
    robot.to_npz(tmp_path / "robot.npz")
    back = ct.Robot.from_npz(tmp_path / "robot.npz")
    for field in robot.__dataclass_fields__:
        before, after = getattr(robot, field), getattr(back, field)
        if isinstance(before, np.ndarray):
            assert np.array_equal(before, after), field
            assert not after.flags.writeable
        else:
            assert before == after, field


def test_npz_of_something_else_is_refused(tmp_path):
    np.savez(tmp_path / "other.npz", a=np.zeros(3))
    with pytest.raises(ct.InvalidField, match=r"a file written by Robot\.to_npz"):
        ct.Robot.from_npz(tmp_path / "other.npz")
    with pytest.raises(MissingFile, match="no such file"):
        ct.Robot.from_npz(tmp_path / "none.npz")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"mass": -1.0}, r"mass: got -1\.0; allowed: mass > 0"),
        ({"mass": float("nan")}, "mass: got nan"),
        ({"tension_min": np.full(4, 900.0)}, r"tension_min\[0\]: got 900\.0; allowed"),
        ({"inertia": np.diag([1.0, 1.0, 3.0])}, "I_max <= sum"),
        ({"inertia": np.diag([1.0, 1.0, -1.0])}, "positive definite"),
        ({"home_rotation": np.diag([1.0, 1.0, -1.0])}, "det"),
        ({"exit_points": np.zeros((3, 3))}, r"exit_points: got shape \(3, 3\)"),
        ({"exit_points": np.full((4, 3), np.inf)}, r"exit_points\[0, 0\]: got inf"),
        ({"cable_names": ()}, "at least one cable"),
        ({"exit_covariance": np.tile(-np.eye(3), (4, 1, 1))}, "positive semidefinite"),
        ({"pulley_radius": np.full(4, 0.05), "swivel_axis": np.ones((4, 3))}, "unit vector"),
    ],
)
def test_numbers_that_cannot_be_are_refused(change, message):
    with pytest.raises(ct.InvalidField, match=message):
        replace(ct.load_robot("carosac"), **change)


def test_arrays_are_read_only_copies():
    points = np.array(ct.load_robot("carosac").exit_points)
    robot = replace(ct.load_robot("carosac"), exit_points=points)
    points[0] = 0.0
    assert robot.exit_points[0, 2] > 8.0
    with pytest.raises(ValueError, match="read-only"):
        robot.exit_points[0, 0] = 1.0


def test_weights_follow_from_masses_and_gravity():
    robot = ct.load_robot("scampi")
    assert robot.weight == pytest.approx(43.164, rel=1e-12)
    assert robot.weight_per_length == pytest.approx(0.1034955, rel=1e-12)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"mass": "abc"}, r"mass: got 'abc'; allowed: a number"),
        ({"mass": True}, r"mass: got True; allowed: a number"),
        ({"gravity": np.array([9.81])}, r"gravity: got array.*; allowed: a number"),
        ({"cable_names": "abcd"}, r"cable_names: got 'abcd'; allowed: at least one cable"),
        ({"cable_names": ("a", "b", "b", "c")}, r"all names different"),
    ],
)
def test_wrong_kinds_are_named(change, message):
    with pytest.raises(ct.InvalidField, match=message):
        simple_robot(**change)


def test_a_file_that_is_no_robot_is_refused_and_none_is_half_written(tmp_path):
    text = tmp_path / "robot.npz"
    text.write_text("no robot")
    with pytest.raises(ct.InvalidField, match=r"a file written by Robot\.to_npz"):
        ct.Robot.from_npz(text)
    with pytest.raises(ct.CarosacError, match="the folder must exist"):
        simple_robot().to_npz(tmp_path / "missing" / "robot.npz")
    simple_robot().to_npz(tmp_path / "good.npz")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["good.npz", "robot.npz"]
