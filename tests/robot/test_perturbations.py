from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest

from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.robot.condition_file import find_condition
from carosac_toolkit.robot.file import load_robot
from carosac_toolkit.robot.perturbations import CONDITIONS_BY_NAME, Condition, draw_plant
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.robot.similar import UNITS_BY_FIELD, similar_robot, similarity
from tests.robots import simple_robot

DRAWS = 4000
NAMES = [field.name for field in fields(Robot)]


@pytest.fixture(scope="module")
def drawn():
    """Nominal robot and the fields of 4000 plants of the condition `nominal-1`."""
    robot = simple_robot()
    plants = [
        draw_plant(robot, CONDITIONS_BY_NAME["nominal-1"], np.random.default_rng(seed))
        for seed in range(DRAWS)
    ]
    names = (
        "mass", "center_of_mass", "inertia", "axial_stiffness", "linear_density", "exit_points",
        "anchor_points", "winch_lag", "drag", "angular_drag",
    )  # fmt: skip
    return robot, {name: np.array([getattr(plant, name) for plant in plants]) for name in names}


def within_statistics(values, deviation):
    """Mean zero and the stated standard deviation, five standard errors wide."""
    count = values.size
    assert abs(values.mean()) < 5.0 * deviation / np.sqrt(count)
    assert values.std() == pytest.approx(deviation, rel=5.0 / np.sqrt(2.0 * count))


@pytest.mark.parametrize(
    ("name", "share"),
    [("mass", 0.03), ("axial_stiffness", 0.20), ("linear_density", 0.02), ("winch_lag", 0.20),
     ("drag", np.log(1.5)), ("angular_drag", np.log(1.5))],
)  # fmt: skip
def test_factors_have_the_stated_spread_and_are_positive(drawn, name, share):
    robot, plants = drawn
    factor = plants[name] / getattr(robot, name)
    assert (factor > 0.0).all()
    per_cable = name == "winch_lag"
    within_statistics(np.log(factor if per_cable else factor.reshape(DRAWS, -1)[:, 0]), share)


@pytest.mark.parametrize(
    ("name", "deviation"),
    [("center_of_mass", 0.01), ("exit_points", 5e-3), ("anchor_points", 1e-3)],
)
def test_points_move_by_the_stated_distance_each_axis_on_its_own(drawn, name, deviation):
    robot, plants = drawn
    moved = (plants[name] - getattr(robot, name)).reshape(DRAWS, -1)
    for column in moved.T:
        within_statistics(column, deviation)
    correlation = np.corrcoef(moved.T) - np.eye(moved.shape[1])
    assert np.abs(correlation).max() < 5.0 / np.sqrt(DRAWS)


def test_inertia_is_scaled_as_a_whole(drawn):
    robot, plants = drawn
    factor = plants["inertia"][:, 0, 0] / robot.inertia[0, 0]
    within_statistics(np.log(factor), 0.10)
    assert plants["inertia"] == pytest.approx(factor[:, None, None] * robot.inertia)


def test_cables_are_of_one_batch_winches_are_not(drawn):
    robot, plants = drawn
    for name in ("axial_stiffness", "linear_density"):
        factor = plants[name] / getattr(robot, name)
        assert np.ptp(factor, axis=1).max() < 1e-12
    lag = np.log(plants["winch_lag"] / robot.winch_lag)
    assert np.abs(np.corrcoef(lag.T) - np.eye(robot.n)).max() < 5.0 / np.sqrt(DRAWS)


def test_the_nominal_robot_stays_as_it_is():
    robot, same = simple_robot(), simple_robot()
    draw_plant(robot, CONDITIONS_BY_NAME["nominal-1"], np.random.default_rng(1))
    for name in NAMES:
        assert np.array_equal(getattr(robot, name), getattr(same, name))


def test_without_a_condition_the_plant_is_the_nominal_robot():
    robot = simple_robot()
    plant = draw_plant(robot, find_condition("none"), np.random.default_rng(1))
    for name in NAMES:
        assert np.array_equal(getattr(plant, name), getattr(robot, name)), name


def test_a_draw_does_not_depend_on_what_else_is_drawn():
    robot, full = simple_robot(), CONDITIONS_BY_NAME["nominal-1"]
    plant = draw_plant(robot, full, np.random.default_rng(2))
    for name in ("mass", "exit_points", "winch_lag"):
        only = Condition(**{name: getattr(full, name)})
        alone = draw_plant(robot, only, np.random.default_rng(2))
        assert np.array_equal(getattr(alone, name), getattr(plant, name)), name
    drag = draw_plant(robot, replace(full, mass=0.0, winch_lag=0.0), np.random.default_rng(2))
    assert drag.drag == plant.drag


def test_one_seed_is_one_plant():
    robot = simple_robot()
    one, same, other = (
        draw_plant(robot, CONDITIONS_BY_NAME["nominal-1"], np.random.default_rng(seed))
        for seed in (7, 7, 8)
    )
    assert one.mass == same.mass and np.array_equal(one.exit_points, same.exit_points)
    assert one.mass != other.mass


def test_an_unknown_condition_lists_those_there_are():
    message = r"condition: got 'nominal'; allowed: one of \['nominal-1', 'nominal-2', 'none'\]"
    with pytest.raises(InvalidField, match=message):
        find_condition("nominal")


def test_nominal_2_is_nominal_1_on_carosac_bit_by_bit():
    robot = load_robot("carosac")
    one, two = (CONDITIONS_BY_NAME[name].of(robot) for name in ("nominal-1", "nominal-2"))
    assert one == two
    plants = [draw_plant(robot, c, np.random.default_rng(4)) for c in (one, two)]
    for name in NAMES:
        assert np.array_equal(getattr(plants[0], name), getattr(plants[1], name)), name


@pytest.mark.parametrize("name", ["carosac", "scampi", "cogiro"])
@pytest.mark.parametrize("factor", [0.1, 10.0])
def test_a_plant_of_a_scaled_robot_is_the_scaled_plant(name, factor):
    robot, condition = load_robot(name), CONDITIONS_BY_NAME["nominal-2"]
    plant = draw_plant(robot, condition, np.random.default_rng(6))
    expected = similar_robot(plant, factor)
    scaled = draw_plant(similar_robot(robot, factor), condition, np.random.default_rng(6))
    for field in UNITS_BY_FIELD:
        value, wanted = getattr(scaled, field), getattr(expected, field)
        if wanted is not None:
            assert value == pytest.approx(wanted, rel=1e-12, abs=1e-15), field
    at_one, ratios = condition.of(robot), similarity(factor)
    wind = condition.of(similar_robot(robot, factor))
    assert wind.wind_force == pytest.approx(at_one.wind_force * ratios.of_unit("N"))
    assert wind.wind_time == pytest.approx(at_one.wind_time * ratios.time)
