from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.physics.cable import straight_line
from carosac_toolkit.robot.file import load_robot
from learned.environment import empty_look
from learned.observation import (
    OBSERVATION_PARTS,
    ObservationScales,
    ObservationUnits,
    check_parts,
    observe,
    slices,
)
from tests.robots import eight_cable_robot, simple_robot


@pytest.mark.parametrize("name", ["carosac", "scampi", "cogiro"])
def test_all_straight_lengths_of_the_box_lie_within_the_range_of_actions(name):
    robot = load_robot(name)
    scales = ObservationScales.of(robot)
    rng = np.random.default_rng(0)
    points = rng.uniform(robot.workspace_min, robot.workspace_max, (2000, 3))
    action = scales.to_action(straight_line.inverse_kinematics(robot, points))
    assert np.abs(action).max() <= 1.0
    assert (action.max(axis=0) > 0.5).all() and (action.min(axis=0) < -0.5).all()  # and fill it


def test_actions_and_lengths_are_inverses_with_the_ends_at_one():
    scales = ObservationScales.of(simple_robot())
    action = np.random.default_rng(1).uniform(-1.0, 1.0, (20, 4))
    np.testing.assert_allclose(scales.to_action(scales.to_length(action)), action, atol=1e-12)
    np.testing.assert_allclose(scales.to_length(-np.ones((1, 4)))[0], scales.length_low)
    np.testing.assert_allclose(scales.to_length(np.ones((1, 4)))[0], scales.length_high)


def test_corners_of_the_box_are_at_one():
    robot = simple_robot()
    scales = ObservationScales.of(robot)
    np.testing.assert_allclose(scales.to_unit(robot.workspace_max), 1.0)
    np.testing.assert_allclose(scales.to_unit(robot.workspace_min), -1.0)


@pytest.mark.parametrize(
    ("unit", "parts"),
    [
        ("error", {"error", "mean_error"}), ("speed_error", {"velocity_error"}),
        ("ahead", {"preview"}), ("speed", {"velocity", "target_velocity"}),
        ("acceleration", {"target_acceleration"}), ("tilt", {"tilt"}), ("turn", {"turn"}),
    ],
)  # fmt: skip
def test_each_unit_is_what_counts_as_one_in_its_parts(unit, parts):
    robot, rng = simple_robot(), np.random.default_rng(2)
    look = empty_look(robot, 2, 4)
    look = replace(look, **{name: rng.normal(size=np.shape(x)) for name, x in vars(look).items()})
    usual = ObservationScales.of(robot)
    double = replace(usual.units, **{unit: 2.0 * getattr(usual.units, unit)})
    scales = ObservationScales.of(robot, double)
    for name, part in OBSERVATION_PARTS.items():
        factor = 0.5 if name in parts else 1.0
        np.testing.assert_allclose(part(look, scales), factor * part(look, usual), rtol=1e-12)


def test_each_part_says_what_its_name_says():
    robot = simple_robot()
    scales = ObservationScales.of(robot)
    turned = Rotation.from_rotvec([0.03, 0.0, 0.7]).as_matrix()[None]
    look = replace(
        empty_look(robot, 2, 4), rotation=turned, twist=np.array([[0.1, 0.2, 0.3, 4.0, 5.0, 6.0]]),
        due=robot.home_position[None] + [[0.2, 0.0, -0.1]], due_velocity=np.full((1, 3), 0.5),
        target=robot.home_position[None] + [[0.3, 0.0, -0.2]], target_velocity=np.full((1, 3), 0.7),
        target_acceleration=np.array([[1.0, -2.0, 3.0]]),
        last_action=np.array([[0.1, -0.2, 0.3, -0.4]]), mean_error=np.array([[0.02, 0.0, -0.1]]),
    )  # fmt: skip
    found = {name: part(look, scales)[0] for name, part in OBSERVATION_PARTS.items()}
    np.testing.assert_allclose(found["error"], [-2.0, 0.0, 1.0], atol=1e-12)
    np.testing.assert_allclose(found["velocity"], [0.1, 0.2, 0.3])
    against = (np.array([0.1, 0.2, 0.3]) - 0.5) / 0.3
    np.testing.assert_allclose(found["velocity_error"], against)
    np.testing.assert_allclose(found["turn"], [4.0, 5.0, 6.0])
    tilt = found["tilt"] * 0.2  # the z axis of P in W; at a yaw of 0.7 rad it leans in both
    assert np.linalg.norm(tilt) == pytest.approx(np.sin(2 * np.arcsin(np.linalg.norm(tilt) / 2)),
                                                 rel=1e-3)  # fmt: skip
    np.testing.assert_allclose(tilt, turned[0] @ [0.0, 0.0, 1.0] @ np.eye(3)[:, :2], atol=1e-12)
    ahead = (robot.home_position - look.target[0]) / 0.5
    np.testing.assert_allclose(found["preview"], np.tile(ahead, 2), atol=1e-12)
    np.testing.assert_allclose(found["target_acceleration"], [1.0, -2.0, 3.0])
    np.testing.assert_allclose(found["target"], scales.to_unit(look.target)[0])
    np.testing.assert_allclose(found["last_action"], [0.1, -0.2, 0.3, -0.4])
    np.testing.assert_allclose(found["mean_error"], [0.2, 0.0, -1.0])


def test_units_say_what_counts_as_one():
    robot = simple_robot()
    look = replace(empty_look(robot, 0, 4), twist=np.full((1, 6), 2.0))
    coarse = ObservationScales.of(robot, ObservationUnits(speed=4.0, turn=0.5))
    np.testing.assert_allclose(OBSERVATION_PARTS["velocity"](look, coarse), 0.5)
    np.testing.assert_allclose(OBSERVATION_PARTS["turn"](look, coarse), 4.0)
    with pytest.raises(InvalidField, match="tilt: got 0"):
        ObservationUnits(tilt=0.0)


@pytest.mark.parametrize("robot", [simple_robot(), eight_cable_robot()])
def test_slices_find_each_part_in_the_observation(robot):
    scales = ObservationScales.of(robot)
    look = empty_look(robot, 3, 5)
    names = tuple(reversed(OBSERVATION_PARTS))
    seen = observe(names, look, scales)
    where = slices(names, robot.n, 3, 5)
    for name in names:
        np.testing.assert_array_equal(seen[:, where[name]], OBSERVATION_PARTS[name](look, scales))
    assert sum(part.stop - part.start for part in where.values()) == seen.shape[1]


@pytest.mark.parametrize(
    "parts, message",
    [
        ((), "observation: got no parts"),
        (("target", "wind"), r"observation\[1\]: got 'wind'; allowed: one of"),
        (("target", "target"), r"observation\[1\]: got 'target'; allowed: .* each once"),
    ],
)
def test_observations_of_nothing_and_of_the_unknown_are_refused(parts, message):
    with pytest.raises(InvalidField, match=message):
        check_parts(parts)
