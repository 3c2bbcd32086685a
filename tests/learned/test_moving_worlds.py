import copy
from dataclasses import replace

import numpy as np
import pytest

from carosac_toolkit.base.errors import CarosacError, InvalidField
from carosac_toolkit.base.scaled import resolved
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.robot.file import load_robot
from carosac_toolkit.robot.similar import similar_robot
from carosac_toolkit.robot.sizes import cable_size
from learned.moving_worlds import MovingSettings, MovingWorlds
from tests.robots import simple_robot

PERIOD = 0.05
CALM = MovingSettings(perturbation="none", position_bias=0.0, length_bias=0.0, start_speed=0.0)
START = np.array([[0.4, -1.8, 2.2], [1.0, -1.0, 3.0], [-0.5, -2.5, 2.5]])


def made(settings, seed=0, size=3):
    return MovingWorlds(simple_robot(), settings, PERIOD, size, seed)


def bias(reached):
    return reached.belief.position - reached.position


def motion(worlds, length, steps=6):
    """Positions while the winches are asked for a little more and less."""
    found = []
    for k in range(steps):
        found.append(worlds.advance(length + 0.02 * np.sin(k)).position)
    return np.stack(found)


@pytest.mark.parametrize("cables", ["catenary", "particles"])
def test_a_platform_without_disturbance_stays_at_rest_on_held_lengths(cables):
    settings = MovingSettings(
        cables=cables, perturbation="none", position_bias=0.0, length_bias=0.0, start_speed=0.0
    )
    worlds = made(settings)
    start = worlds.reset(np.arange(3), START)
    np.testing.assert_allclose(start.position, START, atol=1e-5)
    for _ in range(10):
        reached = worlds.advance(start.length)
    np.testing.assert_allclose(reached.position, START, atol=2e-5)
    np.testing.assert_allclose(reached.twist, 0.0, atol=1e-4)
    np.testing.assert_allclose(reached.length, start.length, atol=1e-9)
    assert not reached.failed.any()


def test_platforms_start_at_rest_on_the_lengths_that_are_asked_for():
    """As a robot does that waits where its path begins: no cable jerks when it goes on."""
    worlds = made(MovingSettings(start_speed=0.0, length_bias=0.02))
    asked = statics.inverse_kinematics(simple_robot(), START).unstrained_length
    start = worlds.reset(np.arange(3), START)
    np.testing.assert_allclose(start.length, asked, atol=1e-9)
    assert (np.linalg.norm(start.position - START, axis=1) > 5e-3).all()
    rest = worlds.hung(asked)
    np.testing.assert_allclose(start.position, rest.position, atol=1e-4)
    np.testing.assert_allclose(start.tension, rest.tension, atol=0.1)
    reached = worlds.advance(asked)
    np.testing.assert_allclose(reached.position, start.position, atol=2e-3)  # wind blows
    np.testing.assert_allclose(reached.tension, start.tension, atol=3.0)


def test_winches_lag_behind_what_they_are_asked_for():
    worlds = made(CALM)
    start = worlds.reset(np.arange(3), START)
    reached = worlds.advance(start.length + 0.01)
    share = (reached.length - start.length) / 0.01
    assert (share > 0.3).all() and (share < 0.9).all()  # 0.63 of a first-order lag after 0.05 s


def test_encoders_agree_with_commands_and_err_in_the_length_wound():
    """Command and reading share the bias, so it shows in where the platform hangs alone."""
    biased = MovingSettings(
        perturbation="none", position_bias=0.0, length_bias=0.02, start_speed=0.0
    )
    worlds = made(biased)
    worlds.reset(np.arange(3), START)
    asked = statics.inverse_kinematics(simple_robot(), START).unstrained_length
    for _ in range(20):
        reached = worlds.advance(asked)
    np.testing.assert_allclose(reached.length, asked, atol=1e-6)
    assert (np.linalg.norm(reached.position - START, axis=1) > 5e-3).all()


def test_biases_and_speeds_have_the_spread_that_was_set():
    settings = MovingSettings(
        perturbation="none", position_bias=0.01, length_bias=0.0, start_speed=0.2
    )
    worlds = made(settings, size=60)
    reached = worlds.reset(np.arange(60), np.repeat(START[:1], 60, axis=0))
    assert np.std(bias(reached)) == pytest.approx(0.01, rel=0.2)  # 180 draws: 5 % sigma
    assert np.std(reached.twist[:, :3]) == pytest.approx(0.2, rel=0.2)
    np.testing.assert_allclose(reached.position, np.repeat(START[:1], 60, axis=0), atol=1e-5)
    again = worlds.reset(np.array([0]), START[:1])  # only those that begin anew are drawn anew
    assert (np.abs(bias(again)[0] - bias(reached)[0]) > 1e-6).all()
    np.testing.assert_allclose(bias(again)[1:], bias(reached)[1:], atol=1e-12)


def test_a_seed_repeats_the_motion_bit_for_bit_and_another_does_not():
    def moved(seed):
        worlds = made(MovingSettings(), seed)
        return motion(worlds, worlds.reset(np.arange(3), START).length)

    np.testing.assert_array_equal(moved(1), moved(1))
    assert np.abs(moved(1) - moved(2)).max() > 1e-3


def test_restored_worlds_go_on_bit_by_bit():
    worlds = made(MovingSettings(), 3)
    length = worlds.reset(np.arange(3), START).length
    motion(worlds, length)
    state = copy.deepcopy(worlds.state())

    def go_on(worlds):
        first = motion(worlds, length)
        reset = worlds.reset(np.array([1]), START[:1])
        return first, bias(reset), motion(worlds, reset.length)

    expected = go_on(worlds)
    other = made(MovingSettings(), 3)  # as after a kill
    for again in (worlds, other):
        again.restore(state)
        for one, two in zip(expected, go_on(again), strict=True):
            np.testing.assert_array_equal(one, two)


def test_a_plant_that_cannot_rest_at_a_start_begins_on_the_way_home():
    worlds = made(CALM, size=1)
    far = np.array([[0.4, -1.8, 8.3]])  # above what tensions can hold
    found = worlds.reset(np.array([0]), far).position[0]
    home = simple_robot().home_position
    assert 2.2 < found[2] < 8.3
    np.testing.assert_allclose(found[:2], home[:2], atol=1e-5)
    with pytest.raises(CarosacError, match="simple: a plant that was drawn cannot rest near"):
        worlds.reset(np.array([0]), np.array([[0.4, -1.8, 60.0]]))


@pytest.mark.parametrize("factor", [0.1, 1.0, 10.0])
def test_default_biases_shrink_with_a_robot_but_do_not_grow(factor):
    robot, share = similar_robot(simple_robot(), factor), min(factor * carosac_size(), 1.0)
    usual, period = MovingSettings(perturbation="none", start_speed=0.0), PERIOD * factor**0.5
    stated = replace(usual, position_bias=0.01 * share, length_bias=0.005 * share)
    states = []
    for settings in (usual, stated):
        worlds = MovingWorlds(robot, settings, period, 3, 0)
        worlds.reset(np.arange(3), factor * START)
        states.append(worlds.state())
    for name in ("position_bias", "length_bias"):
        np.testing.assert_allclose(states[0][name], states[1][name], rtol=1e-12)


def test_default_biases_are_as_stated_on_carosac():
    settings = resolved(MovingSettings(), Scales(load_robot("carosac")).ratios)
    assert (settings.position_bias, settings.length_bias) == (0.01, 0.005)


def carosac_size():
    """Size of the simple robot over that of carosac."""
    return cable_size(simple_robot()) / cable_size(load_robot("carosac"))


def test_negative_spreads_are_refused():
    for name in ("position_bias", "length_bias", "start_speed"):
        with pytest.raises(InvalidField, match=f"{name}: got -1.0"):
            MovingSettings(**{name: -1.0})
