from dataclasses import replace

import numpy as np
import pytest

from carosac_toolkit.base.errors import CarosacError, InvalidField
from learned.target_paths import PathPool, PathSettings, draw_path, sampled
from tests.robots import simple_robot


def drawn(settings, seed=0, feasible=None):
    return draw_path(simple_robot(), settings, np.random.default_rng(seed), feasible)


@pytest.mark.parametrize("kind", ["spline", "minimum_snap"])
def test_targets_lie_in_the_workspace_box_and_repeat_with_the_seed(kind):
    robot, settings = simple_robot(), PathSettings(kind=kind, steps=50)
    for seed in range(5):
        path = drawn(settings, seed)
        assert len(path.position) == 51
        assert (path.position >= robot.workspace_min - 1e-9).all()
        assert (path.position <= robot.workspace_max + 1e-9).all()
        np.testing.assert_array_equal(path.position, drawn(settings, seed).position)
    assert np.abs(drawn(settings, 0).position - drawn(settings, 1).position).max() > 0.1


def test_velocity_is_the_slope_of_the_targets_and_keeps_to_the_speed():
    settings = PathSettings(period=0.01, steps=200, speed=(0.5, 2.0))
    path = drawn(settings)
    slope = (path.position[2:] - path.position[:-2]) / 0.02
    np.testing.assert_allclose(path.velocity[1:-1], slope, atol=0.01)
    assert np.linalg.norm(path.velocity, axis=1).max() <= 2.0 * 1.001


def test_set_points_go_from_the_start_to_the_end_of_the_curve_and_stand_still():
    class Line:
        duration = 4.0

        def sample(self, times):
            place = np.stack([times, 2.0 * times, 0.0 * times], axis=1)
            one = np.ones_like(place)
            values = {"position": place, "velocity": one, "acceleration": 2.0 * one}
            return type("Sampled", (), values)

    path = sampled(Line(), PathSettings(steps=8))
    np.testing.assert_allclose(path.position[:, 0], 0.5 * np.arange(9))
    np.testing.assert_array_equal(path.velocity, 0.0)
    np.testing.assert_array_equal(path.acceleration, 0.0)
    timed = sampled(Line(), PathSettings(steps=8, period=0.25))
    np.testing.assert_allclose(timed.position[:, 0], 0.25 * np.arange(9))
    np.testing.assert_array_equal(timed.velocity, 1.0)
    np.testing.assert_array_equal(timed.acceleration, 2.0)


def test_a_path_goes_on_beyond_the_episode():
    long = drawn(PathSettings(period=0.05, steps=30))
    short = drawn(PathSettings(period=0.05, steps=10))
    for k in (10, 11, 30):
        np.testing.assert_allclose(short.targets()[k], long.targets()[k], atol=1e-12)
    end, *still = short.targets()[31]  # a second beyond the episode no more is known
    np.testing.assert_array_equal(end, short.targets()[30, 0])
    np.testing.assert_array_equal(still, 0.0)


def test_after_its_end_a_path_rests_on_its_last_target():
    path = replace(drawn(PathSettings(period=0.05, steps=10)), later=None)
    position, velocity, acceleration = path.targets()[10]
    beyond, *still = path.targets()[-1]
    np.testing.assert_array_equal(position, path.position[10])
    np.testing.assert_array_equal(velocity, path.velocity[10])
    np.testing.assert_array_equal(acceleration, path.acceleration[10])
    np.testing.assert_array_equal(beyond, path.position[10])
    np.testing.assert_array_equal(still, 0.0)


def test_paths_with_an_infeasible_target_are_drawn_again(monkeypatch):
    def low(position):
        return position[:, 2] < 4.0

    settings = PathSettings(steps=20)
    assert any((drawn(settings, seed).position[:, 2] >= 4.0).any() for seed in range(5))
    for seed in range(5):
        assert low(drawn(settings, seed, low).position).all()
    monkeypatch.setattr("learned.target_paths.PATH_ATTEMPTS_MAX", 3)
    with pytest.raises(CarosacError, match=r"simple: none of 3 random paths .* is feasible"):
        drawn(settings, 0, lambda position: np.zeros(len(position), dtype=bool))


def test_a_robot_that_can_rest_hardly_anywhere_is_not_asked_for_every_point_of_every_path():
    asked = []

    def nowhere(position):
        asked.append(len(position))
        return np.zeros(len(position), dtype=bool)

    with pytest.raises(CarosacError, match="random paths"):
        drawn(PathSettings(steps=400), 0, nowhere)
    assert max(asked) <= 11


@pytest.mark.parametrize(
    "changes, message",
    [
        ({"kind": "circle"}, "kind: got 'circle'; allowed: one of"),
        ({"speed": (2.0, 1.0)}, "speed: got .* allowed: 0 < least <= largest"),
        ({"acceleration_max": 0.0}, "acceleration_max: got 0.0 m/s"),
        ({"steps": 0}, "steps: got 0; allowed: a whole number from 1"),
        ({"steps": 2.5}, "steps: got 2.5; allowed: a whole number from 1"),
        ({"period": 0.0}, "period: got 0.0 s"),
    ],
)
def test_settings_without_sense_are_refused(changes, message):
    with pytest.raises(InvalidField, match=message):
        PathSettings(**changes)


def test_a_pool_draws_each_path_once_and_the_same_for_the_same_seed():
    settings = PathSettings(steps=5, pool=3)
    pool, other = PathPool(simple_robot(), settings, 4), PathPool(simple_robot(), settings, 4)
    second = other.path(1)  # in another order
    first, again = pool.path(0), pool.path(0)
    assert first is again
    np.testing.assert_array_equal(other.path(0).position, first.position)
    np.testing.assert_array_equal(second.position, pool.path(1).position)
    assert np.abs(first.position - second.position).max() > 0.1
    foreign = PathPool(simple_robot(), settings, 5).path(0)
    assert np.abs(foreign.position - first.position).max() > 0.1


def test_scattered_points_are_feasible_and_dense_at_the_faces_of_the_box():
    robot = simple_robot()
    settings = PathSettings(kind="scatter", steps=2000)
    middle = (robot.workspace_max + robot.workspace_min) / 2
    half = (robot.workspace_max - robot.workspace_min) / 2
    path = drawn(settings)
    unit = np.abs((path.position - middle) / half)
    assert unit.max() <= 1.0
    inner = (unit < 0.5).mean()  # of the density of Chebyshev nodes, a third
    assert inner == pytest.approx(1.0 / 3.0, abs=0.03)
    np.testing.assert_array_equal(path.velocity, 0.0)
    half_box = draw_path(robot, settings, np.random.default_rng(0), lambda p: p[:, 0] > middle[0])
    assert (half_box.position[:, 0] > middle[0]).all()
    assert len(half_box.position) == 2001


def test_scattered_points_have_no_time():
    with pytest.raises(InvalidField, match="kind: got 'scatter'"):
        PathSettings(kind="scatter", period=0.05)
