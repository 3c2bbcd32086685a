import copy

import numpy as np
import pytest

import carosac_toolkit as ct
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.drivers.sensors import PERFECT_SENSORS, SensorSettings
from carosac_toolkit.loop import plugins
from carosac_toolkit.loop.loop import run
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.trajectories import line
from learned.moving_worlds import MovingSettings, MovingWorlds
from tests.robots import simple_robot

PERIOD = 0.025
START = np.array([[0.4, -1.8, 2.2], [1.0, -1.0, 3.0], [-0.5, -2.5, 2.5]])
CALM = MovingSettings(
    perturbation="none", position_bias=0.0, length_bias=0.0, start_speed=0.0,
    estimator="dynamic_estimator",
)  # fmt: skip


def made(settings, seed=0, size=3):
    return MovingWorlds(simple_robot(), settings, PERIOD, size, seed)


def moved(worlds, steps=20):
    """Where worlds are and are believed to be, while all go the same way."""
    truth, belief = [], []
    for k in range(steps):
        where = START + np.array([0.0, 0.01 * k, 0.0])
        length = statics.inverse_kinematics(simple_robot(), where).unstrained_length
        reached = worlds.advance(length)
        truth.append(np.hstack([reached.position, reached.twist]))
        belief.append(np.hstack([reached.belief.position, reached.belief.twist]))
    return np.stack(truth), np.stack(belief)


def test_with_perfect_sensors_the_belief_is_the_truth(monkeypatch):
    monkeypatch.setattr("learned.sensing.SensorSettings", lambda: PERFECT_SENSORS)
    worlds = made(CALM)
    worlds.reset(np.arange(3), START)
    truth, belief = moved(worlds)
    np.testing.assert_allclose(belief[..., :3], truth[..., :3], atol=8e-3)
    assert np.abs(truth[-1, :, 4]).min() > 0.2  # [m/s]
    np.testing.assert_allclose(belief[-1, :, 4], truth[-1, :, 4], atol=0.1)


def test_the_belief_errs_by_what_the_encoders_say_and_each_start_has_encoders_of_its_own():
    worlds = made(CALM)
    errors = []
    for _ in range(2):
        reached = worlds.reset(np.arange(3), START)
        errors.append(reached.belief.position - reached.position)
        assert 2e-3 < np.linalg.norm(errors[-1], axis=1).mean() < 0.05
        np.testing.assert_array_equal(reached.twist, 0.0)
    assert (np.linalg.norm(errors[0] - errors[1], axis=1) > 1e-3).all()
    worlds.reset(np.array([1]), START[1:2])
    kept = worlds._reached()
    for row, same in ((0, True), (1, False), (2, True)):
        error = kept.belief.position[row] - kept.position[row]
        assert np.allclose(error, errors[1][row], atol=1e-12) == same


def test_command_and_encoders_agree():
    """A winch closes its loop on its own encoder: what is asked for is what is read later."""
    worlds = made(CALM)
    worlds.reset(np.arange(3), START)
    asked = statics.inverse_kinematics(simple_robot(), START).unstrained_length
    for _ in range(40):
        reached = worlds.advance(asked)
    sensing = worlds._sensing
    read = sensing._sensors.newest_lengths(sensing._now)
    np.testing.assert_allclose(read, asked, atol=1.2e-3)  # six times the noise of a reading
    assert np.abs(sensing.encoder_bias).max() > 4e-3
    np.testing.assert_allclose(reached.length, asked, atol=1e-6)


def test_a_share_of_the_worlds_has_estimators():
    settings = MovingSettings(
        perturbation="none", position_bias=0.01, start_speed=0.2, estimated=0.3,
        estimator="dynamic_estimator",
    )  # fmt: skip
    worlds = made(settings)
    reached = worlds.reset(np.arange(3), START)
    assert (np.abs(reached.twist[:, :3]) > 1e-3).all()
    np.testing.assert_array_equal(reached.belief.twist[0], 0.0)  # estimators begin at rest
    truth, belief = moved(worlds, 5)
    error = belief - truth
    np.testing.assert_allclose(np.ptp(error[:, 1:, :3], axis=0), 0.0, atol=1e-12)  # constant
    np.testing.assert_array_equal(error[:, 1:, 3:], 0.0)
    assert (np.ptp(error[:, 0], axis=0)[:3] > 0.0).all()


def test_restored_worlds_believe_on_bit_by_bit():
    worlds = made(MovingSettings(estimator="dynamic_estimator", estimated=0.6), 3)
    worlds.reset(np.arange(3), START)
    moved(worlds, 4)
    state = copy.deepcopy(worlds.state())

    def go_on(worlds):
        first = moved(worlds, 4)
        worlds.reset(np.array([1]), START[:1])
        return np.stack([*first, *moved(worlds, 4)])

    expected = go_on(worlds)
    other = made(MovingSettings(estimator="dynamic_estimator", estimated=0.6), 3)
    for again in (worlds, other):
        again.restore(state)
        np.testing.assert_array_equal(go_on(again), expected)


def test_a_belief_is_what_driver_and_loop_would_give(monkeypatch):
    """The same plant on the same lengths, from the same sensors without bias and noise."""
    robot = ct.load_robot("carosac")
    quiet = SensorSettings(
        encoder_noise=0.0, encoder_bias=0.0, angular_rate_noise=0.0, angular_rate_bias=0.0,
        specific_force_noise=0.0, specific_force_bias=0.0,
    )  # fmt: skip
    monkeypatch.setattr("learned.sensing.SensorSettings", lambda: quiet)
    start = robot.home_position
    path = line(start, start + np.array([0.0, 0.5, 0.0]), speed_max=0.5, acceleration_max=1.0)
    kind = plugins.load("drivers", "simulator")
    settings = kind.Settings(
        suite="lengths+imu", period=PERIOD, sensors=quiet, start_position=tuple(start)
    )
    solver = plugins.load("controllers", "kinematic_solver")
    controller = solver.build(robot, solver.Settings(period=PERIOD))
    estimator = plugins.load("estimators", "dynamic_estimator").build(robot)
    log = run(kind.build(robot, settings), estimator, controller, path, duration=1.0)
    worlds = MovingWorlds(
        robot,
        MovingSettings(
            cables="particles", perturbation="none", position_bias=0.0, length_bias=0.0,
            start_speed=0.0, estimator="dynamic_estimator",
        ),
        PERIOD, 1, 0,
    )  # fmt: skip
    worlds.reset(np.arange(1), start[None])
    for k in range(1, len(log.time)):
        reached = worlds.advance(log.command[k - 1])
        np.testing.assert_allclose(reached.position, log.position[k], atol=1e-9)
        np.testing.assert_allclose(reached.belief.position, log.belief_position[k], atol=1e-9)


@pytest.mark.parametrize(
    "changes, message",
    [
        ({"estimated": 0.0}, "estimated: got 0.0; allowed: 0 < estimated <= 1"),
        ({"suite": "imu"}, "suite: got 'imu'"),
        ({"estimated": 0.5}, "estimated: got '?0.5'?; allowed: 1.0, or an estimator"),
        ({"suite": "lengths"}, "suite: got 'lengths'; allowed: 'lengths\\+imu', or an estimator"),
    ],
)
def test_settings_that_make_no_sense_are_refused(changes, message):
    with pytest.raises(InvalidField, match=message):
        MovingSettings(**changes)


def test_an_estimator_that_remembers_beside_its_beliefs_is_refused():
    worlds = made(MovingSettings(estimator="simulator"))
    with pytest.raises(InvalidField, match="'simulator'; allowed: one whose beliefs hold all"):
        worlds.reset(np.arange(3), START)


def test_an_estimator_without_velocities_is_refused():
    worlds = made(MovingSettings(estimator="kinematic_solver"))
    with pytest.raises(InvalidField, match="'kinematic_solver'; allowed: one that gives veloc"):
        worlds.reset(np.arange(3), START)


def test_later_episodes_begin_with_all_sensors_as_the_first_one_does():
    worlds = made(CALM)
    seen = []
    sensing = worlds._sensing
    estimator, reset = sensing._estimator, sensing._estimator.reset
    estimator.reset = lambda measured: seen.append(measured) or reset(measured)
    worlds.reset(np.arange(3), START)
    moved(worlds, 3)
    worlds.reset(np.array([1]), START[1:2])
    assert all(one.imu is not None and one.imu.time.shape == (1, 1) for one in seen)


def test_an_estimator_that_is_not_there_is_refused():
    with pytest.raises(InvalidField, match="did you mean 'dynamic_estimator'"):
        made(MovingSettings(estimator="dynamic_estimtor"))
