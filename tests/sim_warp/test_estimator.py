from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import carosac_toolkit as ct
from baselines.kinematic_solver import KinematicSolver
from carosac_toolkit.base.errors import CarosacError, InvalidField
from carosac_toolkit.drivers.sensors import PERFECT_SENSORS
from carosac_toolkit.loop.values import Command, Measurement
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.validation import validate
from carosac_toolkit.validation.run import run_open_loop
from sim_warp import (
    SimDriver,
    SimDriverSettings,
    Simulator,
    SimulatorEstimator,
    SimulatorSettings,
)
from sim_warp.delayed_lengths import DelayedLengths
from tests.robots import simple_robot

ROBOT = simple_robot()
PERIOD = 0.02


def estimator(**changes):
    return SimulatorEstimator.build(ROBOT, SimulatorSettings(**changes))


def measured(time, lengths):
    lengths = np.atleast_2d(lengths)
    return Measurement(time=np.full(len(lengths), time), unstrained_length=lengths)


def play(model, series):
    """Beliefs after each of the measurements."""
    beliefs = []
    for row in series:
        command = Command(time=row.time, unstrained_length=row.unstrained_length)
        beliefs.append(
            model.update(beliefs[-1], command, row) if beliefs else model.reset(row)
        )  # fmt: skip
    return beliefs


def positions(beliefs):
    return np.array([belief.position[0] for belief in beliefs])


def wound(count):
    """Lengths of rest every 20 ms along x at 0.4 m/s for 0.6 s, then held, shape (count, n)."""
    path = np.tile(ROBOT.home_position, (count, 1))
    path[:, 0] += 0.4 * np.minimum(PERIOD * np.arange(count), 0.6)
    return statics.inverse_kinematics(ROBOT, path).unstrained_length


@pytest.fixture(scope="module")
def ramps():
    """Lengths that wind along x and stop, every 20 ms."""
    return [measured(PERIOD * k, row) for k, row in enumerate(wound(60))]


@pytest.fixture(scope="module")
def swinging():
    """Measurements and truths of a simulated robot that is wound along x and then swings."""
    driver = SimDriver.build(ROBOT, SimDriverSettings(sensors=PERFECT_SENSORS))
    driver.connect()
    seen, truths = [], []
    for row in wound(150):
        seen.append(driver.measure())
        truths.append(driver.truth())
        driver.command(Command(time=seen[-1].time, unstrained_length=row[None]))
        driver.wait(PERIOD)
    return seen, truths


def test_it_follows_a_swing_that_the_kinematic_solver_cannot_see(swinging):
    seen, truths = swinging
    truth = np.array([t.position[0] for t in truths])
    beliefs = play(estimator(), seen)
    error = np.linalg.norm(positions(beliefs) - truth, axis=1)
    resting = np.linalg.norm(positions(play(KinematicSolver.build(ROBOT), seen)) - truth, axis=1)
    # lengths are not straight between samples: at 5 m/s^2 they bend by a h^2 / 8 = 0.25 mm
    assert error.max() < 1e-3 < 0.03 < resting.max()
    speed = np.array([t.twist[0, 0] for t in truths])
    believed = np.array([b.twist[0, 0] for b in beliefs])
    assert np.abs(believed - speed).max() < 0.05 * np.abs(speed).max()
    assert all(b.converged.all() for b in beliefs)
    pull, believed = (np.array([x.tension[0] for x in xs])[100:] for xs in (truths, beliefs))
    assert believed.mean(axis=0) == pytest.approx(pull.mean(axis=0), rel=0.01)


def test_it_starts_at_rest_where_the_first_lengths_put_it():
    rest = statics.inverse_kinematics(ROBOT, [[0.8, -1.0, 2.5]])
    (belief,) = play(estimator(), [measured(5.0, rest.unstrained_length)])
    assert belief.position == pytest.approx(rest.position, abs=1e-5)
    assert belief.rotation == pytest.approx(rest.rotation, abs=1e-4)
    assert not belief.twist.any()
    assert belief.tension == pytest.approx(rest.tension, rel=1e-3)


def test_a_delay_of_two_samples_is_the_same_motion_two_samples_later(ramps):
    now = positions(play(estimator(), ramps))
    late = positions(play(estimator(delay=2.0 * PERIOD), ramps))
    # The lengths set out with a jerk, which the first step after a reset takes another way.
    assert late[2:] == pytest.approx(now[:-2], abs=3e-3)
    assert late[:3] == pytest.approx(np.tile(now[0], (3, 1)), abs=1e-5)  # at rest
    assert np.abs(late - now).max() > 6e-3


@pytest.mark.parametrize("delay", [0.0, 0.004, 0.033, 0.05])
def test_delayed_lengths_are_those_of_a_straight_interpolation(delay):
    rng = np.random.default_rng(1)
    time = np.concatenate([[0.0], np.cumsum(rng.uniform(0.005, 0.03, 40))])
    lengths = 5.0 + rng.standard_normal((41, 2))
    path = DelayedLengths(lengths[:1], delay, segment=0.03)
    now = 0.0
    for k in range(1, 41):
        for duration, reached in path.advance(time[k] - time[k - 1], lengths[k : k + 1]):
            assert duration > 0.0
            now += duration
            wanted = [np.interp(now - delay, time, column) for column in lengths.T]
            assert reached[0] == pytest.approx(wanted, abs=1e-9)
        assert now == pytest.approx(time[k], abs=1e-12)


@pytest.mark.parametrize("delay", [0.0, 0.033, 0.3])
def test_rare_lengths_that_accelerate_are_followed_in_short_segments(delay):
    time = np.cumsum([0.0, 0.2, 0.25, 0.3, 0.2, 0.25, 0.25])
    lengths = 5.0 + 0.3 * time - 0.4 * time**2
    path = DelayedLengths(lengths[:1, None], delay, segment=0.05)
    now = 0.0
    for k in range(1, len(time)):
        for duration, reached in path.advance(time[k] - time[k - 1], lengths[k : k + 1, None]):
            now += duration
            then = now - delay
            if then > time[1]:  # from the third sample on the acceleration is known
                assert duration <= 0.05 + 1e-9
                assert reached == pytest.approx(5.0 + 0.3 * then - 0.4 * then**2, abs=1e-9)
        assert now == pytest.approx(time[k], abs=1e-12)


def test_a_batch_is_what_its_rows_are_alone(ramps):
    other = [replace(row, unstrained_length=row.unstrained_length[:, ::-1]) for row in ramps]
    both = [
        measured(a.time[0], np.concatenate([a.unstrained_length, b.unstrained_length]))
        for a, b in zip(ramps, other, strict=True)
    ]
    together = play(estimator(), both)
    for b, series in enumerate((ramps, other)):
        alone = play(estimator(), series)
        for row, one in zip(together, alone, strict=True):
            assert np.array_equal(row.position[b], one.position[0])
            assert np.array_equal(row.twist[b], one.twist[0])


def test_another_reset_starts_anew_for_any_number_of_robots(ramps):
    model = estimator()
    first = positions(play(model, ramps))
    pair = measured(0.0, np.repeat(ramps[0].unstrained_length, 2, axis=0))
    assert play(model, [pair])[0].position.shape == (2, 3)
    assert np.array_equal(positions(play(model, ramps)), first)


def test_only_the_last_belief_can_be_updated(ramps):
    model = estimator()
    command = Command(time=np.zeros(1), unstrained_length=ramps[0].unstrained_length)
    beliefs = play(model, ramps[:3])
    message = r"simulator: update\(\) of a belief at 0.02 s that is not the last one, that at 0.04"
    with pytest.raises(CarosacError, match=message):
        model.update(beliefs[1], command, ramps[3])
    with pytest.raises(CarosacError, match="none yet"):
        estimator().update(beliefs[1], command, ramps[3])
    moved = replace(beliefs[2], covariance=np.tile(np.eye(12), (1, 1, 1)))  # its memory counts
    assert model.update(moved, command, ramps[3]).memory.updates == 4


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"time": np.zeros(1)}, "measurement.time: got 0.0 s after 0.02 s; allowed: later"),
        ({"time": np.full(1, 0.02)}, "later than the last one"),
        ({"unstrained_length": np.full((1, 5), 8.0)}, r"got shape \(1, 5\); allowed: .*\(1, 4\)"),
        ({"unstrained_length": np.full((1, 4), -8.0)}, "got -8.0 m; allowed: > 0 m"),
        ({"time": np.array([0.04, 0.04]), "unstrained_length": np.full((2, 4), 8.0)},
         r"shape \(2, 4\); allowed: shape \(1, 4\)"),
    ],
)  # fmt: skip
def test_a_measurement_that_does_not_follow_is_refused_and_changes_nothing(ramps, changed, message):
    model, untouched = estimator(), estimator()
    beliefs = play(model, ramps[:2])
    command = Command(time=np.zeros(1), unstrained_length=ramps[0].unstrained_length)
    fields = {"time": ramps[2].time, "unstrained_length": ramps[2].unstrained_length}
    with pytest.raises(InvalidField, match=message):
        model.update(beliefs[-1], command, Measurement(**(fields | changed)))
    after = model.update(beliefs[-1], command, ramps[2])
    assert np.array_equal(after.position, play(untouched, ramps[:3])[-1].position)


def test_robots_whose_clocks_go_apart_are_refused(ramps):
    model = estimator()
    two = np.repeat(ramps[0].unstrained_length, 2, axis=0)
    (belief,) = play(model, [measured(0.0, two)])
    later = Measurement(time=np.array([0.02, 0.03]), unstrained_length=two)
    with pytest.raises(InvalidField, match="allowed: the same for all robots"):
        model.update(belief, Command(time=np.zeros(2), unstrained_length=two), later)


def test_lengths_without_a_rest_keep_the_last_good_pose_are_counted_and_left_behind(ramps):
    good, far = ramps[0].unstrained_length[0], np.full(4, 100.0)
    rows = [[good, far], [good, far], [good, good], [good, good]]
    series = [measured(PERIOD * k, np.array(row)) for k, row in enumerate(rows)]
    beliefs = play(estimator(), series)
    found = np.array([b.converged for b in beliefs])
    assert found.tolist() == [[True, False], [True, False], [True, False], [True, True]]
    assert beliefs[-1].memory.failures.tolist() == [0, 3]
    assert beliefs[-1].memory.restarts.tolist() == [0, 1]
    assert np.array_equal(beliefs[2].position[1], ROBOT.home_position)
    assert beliefs[-1].position[1] == pytest.approx(beliefs[-1].position[0], abs=1e-4)
    alone = play(estimator(), [measured(PERIOD * k, good) for k in range(4)])
    assert np.array_equal(beliefs[-1].position[0], alone[-1].position[0])


@pytest.mark.parametrize(
    "options",
    [{"cables": "catenary"}, {"segments": 5}, {"time_step": 1.0 / 240.0}, {"cable_drag": 3.0}],
    ids=lambda options: next(iter(options)),
)
def test_settings_of_the_cables_are_those_of_the_simulator(ramps, options):
    simulator = Simulator(ROBOT, **options)
    simulator.reset(unstrained_length=ramps[0].unstrained_length)
    for row in ramps[1:]:
        simulator.follow(row.unstrained_length, PERIOD)
    there = simulator.state.numpy().position[0]
    assert positions(play(estimator(**options), ramps))[-1] == pytest.approx(there, abs=1e-9)
    assert np.abs(positions(play(estimator(), ramps))[-1] - there).max() > 1e-8


def test_after_a_long_gap_the_platform_is_hung_anew(ramps):
    model = estimator(gap_max=1.0)
    beliefs = play(model, [*ramps[:30], replace(ramps[59], time=np.array([100.0]))])
    rest = statics.forward_kinematics(ROBOT, ramps[59].unstrained_length)
    assert beliefs[-1].position == pytest.approx(rest.position, abs=1e-5)
    assert not beliefs[-1].twist.any()
    assert beliefs[-1].memory.restarts.tolist() == [1]
    assert beliefs[-1].memory.failures.tolist() == [0]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"delay": -0.1}, "delay: got -0.1 s; allowed: delay >= 0"),
        ({"gap_max": 0.0}, "gap_max: got 0.0 s; allowed: gap_max > 0"),
        ({"cables": "ropes"}, "cables: got 'ropes'"),
    ],
)
def test_settings_that_cannot_be_are_named(changes, message):
    with pytest.raises(InvalidField, match=message):
        SimulatorSettings(**changes)


def test_it_follows_the_sway_of_a_real_robot(real_data):
    recording = ct.load_recording(real_data / "scampi_run_part.csv")
    robot = ct.load_robot("scampi")
    scores = validate(recording, robot).models
    assert scores["simulator"].scores.rmse[3] < 0.029 < scores["kinematic_solver"].scores.rmse[3]
    assert scores["simulator"].failures == 0
    # what the statics cannot see, in x: the same swing, in phase and of the same size
    x = {name: scores[name].pose.position[:, 0] for name in ("simulator", "kinematic_solver")}
    real = recording.pose_at(recording.time).pose.position[:, 0] - x["kinematic_solver"]
    simulated = x["simulator"] - x["kinematic_solver"]
    assert np.corrcoef(real, simulated)[0, 1] > 0.75
    assert simulated.std() == pytest.approx(real.std(), rel=0.25)


@pytest.mark.parametrize("cables", ["catenary", "straight"])
def test_cables_without_waves_follow_it_as_well(real_data, cables):
    recording = ct.load_recording(real_data / "scampi_run_part.csv")
    model = SimulatorEstimator.build(ct.load_robot("scampi"), SimulatorSettings(cables=cables))
    found = run_open_loop(model, recording, len(recording.time))
    measured_at = recording.pose_at(recording.time)
    error = (found.position - measured_at.pose.position)[measured_at.valid]
    assert np.sqrt((error**2).sum(axis=1).mean()) < 0.029


def test_the_delay_is_that_of_the_robot_unless_the_settings_say_another(ramps):
    def after(settings, **known):
        robot = replace(ROBOT, **known)
        return positions(
            play(SimulatorEstimator.build(robot, SimulatorSettings(**settings)), ramps)
        )

    late = {"length_delay": 2.0 * PERIOD}
    assert np.array_equal(after({}, **late), after({"delay": 2.0 * PERIOD}))
    assert np.array_equal(after({"delay": 0.0}, **late), after({}))
    assert np.array_equal(after({}, length_delay=0.0), after({}))
    with pytest.raises(InvalidField, match=r"delay: got -0.02 s; allowed: delay >= 0"):
        after({}, length_delay=-PERIOD)
