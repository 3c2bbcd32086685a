"""The dynamic estimator against simulated robots whose truth is known."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import carosac_toolkit as ct
from baselines.dynamic_estimator import DynamicEstimator, DynamicEstimatorSettings
from baselines.dynamic_estimator.measurement_models import ImuMean, MeasurementModels
from baselines.dynamic_estimator.model import DynamicModel
from baselines.dynamic_estimator.rest_start import RestStart
from baselines.dynamic_estimator.settings import settings_for
from baselines.kinematic_solver import KinematicSolver
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.drivers.sensors import PERFECT_SENSORS, SensorSettings
from carosac_toolkit.loop.consistency import band, normalised_square, state_error
from carosac_toolkit.loop.values import Command, Measurement
from carosac_toolkit.robot.condition_file import find_condition
from sim_warp.driver import SimDriver, SimDriverSettings

KNOWN = dict(mass=0.0, center_of_mass=0.0, length_bias=5e-3, length_bias_walk=0.0)
PERIOD = 0.02


@pytest.fixture(scope="module")
def robot():
    return ct.load_robot("carosac")


def swing(robot, suite, sensors, *, seed=0, wind=0.0, duration=6.0, lost=None):
    """Measurements and truths while the platform is thrown into a swing by a quick move."""
    driver = SimDriver.build(
        robot,
        SimDriverSettings(suite=suite, sensors=sensors, cables="catenary", wind_force=wind),
        seed=seed,
    )
    goal = robot.home_position[None] + np.array([0.25, 0.2, 0.1])
    far = ct.statics.inverse_kinematics(robot, goal).unstrained_length
    found = []
    driver.connect()
    first = driver.measure().unstrained_length
    near = ct.statics.inverse_kinematics(robot, robot.home_position[None]).unstrained_length
    for k in range(round(duration / PERIOD)):
        measurement = driver.measure()
        if lost is not None and lost[0] <= k * PERIOD < lost[1]:
            measurement = replace(measurement, imu=None)
        found.append((measurement, driver.truth()))
        share = np.clip((k * PERIOD - 0.5) / 1.0, 0.0, 1.0)
        share = share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
        command = first + share * (far - near)
        driver.command(Command(time=measurement.time, unstrained_length=command))
        driver.wait(PERIOD)
    driver.close()
    return found


def believe(estimator, found):
    """Errors (K, 12) or (K, 6) and beliefs."""
    beliefs, errors = [], []
    for measurement, truth in found:
        command = Command(time=measurement.time, unstrained_length=measurement.unstrained_length)
        belief = (
            estimator.update(beliefs[-1], command, measurement)
            if beliefs
            else estimator.reset(measurement)
        )
        beliefs.append(belief)
        errors.append(state_error(truth, belief)[0])
    return np.array(errors), beliefs


def rms(errors):
    return float(np.sqrt((errors[:, :3] ** 2).sum(axis=1).mean()))


def test_perfect_lengths_alone_give_the_swing(robot):
    """The plant is the model: what is left is the time step, and the last 20 ms of lengths."""
    found = swing(robot, "lengths", PERFECT_SENSORS)
    own, _ = believe(DynamicEstimator.build(robot), found)
    solver, _ = believe(KinematicSolver.build(robot), found)
    assert rms(solver) > 0.04
    assert rms(own) < 0.1 * rms(solver)


def test_noisy_lengths_and_imu_are_better_than_lengths_alone(robot):
    sensors = SensorSettings()
    settings = DynamicEstimatorSettings(**KNOWN)
    wind = dict(seed=3, wind=3.0)
    alone, _ = believe(
        DynamicEstimator.build(robot, settings), swing(robot, "lengths", sensors, **wind)
    )
    with_imu, _ = believe(
        DynamicEstimator.build(robot, settings), swing(robot, "lengths+imu", sensors, **wind)
    )
    speeds = [
        float(np.sqrt((errors[:, 6:9] ** 2).sum(axis=1).mean())) for errors in (alone, with_imu)
    ]
    assert speeds[1] < 0.7 * speeds[0]


def test_nees_is_in_its_band_where_the_model_is_right(robot):
    settings = DynamicEstimatorSettings(**KNOWN)
    runs = 3
    values = []
    for seed in range(runs):
        found = swing(robot, "lengths+imu", SensorSettings(), seed=seed, wind=1.0, duration=3.0)
        errors, beliefs = believe(DynamicEstimator.build(robot, settings), found)
        values += [
            normalised_square(error[:6], belief.covariance[0, :6, :6])
            for error, belief in zip(errors, beliefs, strict=True)
        ]
    low, high = band(6, runs)
    assert low < np.mean(values) < high


def test_poses_find_the_biases_of_the_lengths(robot):
    """Readings that are wrong by centimetres move the platform of a solver, not of this."""
    biased = replace(PERFECT_SENSORS, encoder_bias=0.02, position_noise=1e-3, rotation_noise=5e-4)
    found = swing(robot, "lengths+pose", biased, seed=5)
    estimator = DynamicEstimator.build(robot, DynamicEstimatorSettings(length_bias=0.02))
    errors, beliefs = believe(estimator, found)
    assert rms(errors[-50:]) < 3e-3
    first = found[0][0].unstrained_length
    near = ct.statics.inverse_kinematics(robot, robot.home_position[None]).unstrained_length
    bias = beliefs[-1].memory.tracks[0].state.length_bias
    assert bias == pytest.approx((first - near)[0], abs=4e-3)


def test_what_an_imu_off_centre_feels_is_the_motion_of_where_it_sits(robot):
    """Specific force there: second difference of the path of that point, seen in its axes."""
    lever, mount = np.array([0.1, -0.2, 0.05]), np.array([0.3, -0.5, 1.0])
    mounted = DynamicEstimatorSettings(imu_position=tuple(lever), imu_rotation=tuple(mount))
    settings = settings_for(robot, mounted)
    model = DynamicModel(robot, settings)
    home = ct.statics.inverse_kinematics(robot, robot.home_position[None])
    length = home.unstrained_length[0]
    state = RestStart(robot, settings, model.errors).state(0.0, length)
    turn = Rotation.from_rotvec([0.15, -0.1, 0.05]).as_matrix()
    state = replace(
        state, rotation=turn @ state.rotation, twist=np.array([0.2, -0.1, 0.05, 0.4, -0.6, 0.8])
    )
    h, moves = 1e-3, []
    for _ in range(3):
        moves.append(model.step(state, length, length, h))
        state = moves[-1].state
    points = [move.state.position + move.state.rotation @ lever for move in moves]
    axes = moves[1].state.rotation @ Rotation.from_rotvec(mount).as_matrix()
    lift = (points[0] - 2.0 * points[1] + points[2]) / h**2 + [0.0, 0.0, robot.gravity]
    assert moves[1].felt[3:] == pytest.approx(axes.T @ lift, rel=0.01, abs=0.3)
    between = Rotation.from_matrix(moves[0].state.rotation.T @ moves[2].state.rotation)
    rate = moves[1].state.rotation @ between.as_rotvec() / (2.0 * h)
    assert moves[1].felt[:3] == pytest.approx(axes.T @ rate, abs=0.05)


def test_a_lost_imu_is_missed_and_found_again(robot):
    settings = DynamicEstimatorSettings(**KNOWN)
    scene = dict(wind=1.0, duration=9.0)
    whole = swing(robot, "lengths+imu", SensorSettings(), **scene)
    found = swing(robot, "lengths+imu", SensorSettings(), **scene, lost=(1.0, 5.0))
    always, _ = believe(DynamicEstimator.build(robot, settings), whole)
    errors, beliefs = believe(DynamicEstimator.build(robot, settings), found)
    dof = [belief.innovations.dof[0] for belief in beliefs]
    assert dof[round(4.0 / PERIOD)] == 0 < dof[round(6.0 / PERIOD)]
    late = slice(round(7.5 / PERIOD), None)
    assert rms(errors[late]) < 1.5 * rms(always[late])


def test_an_outlier_of_a_length_is_counted_and_not_believed(robot):
    found = swing(robot, "lengths", PERFECT_SENSORS, duration=2.0)
    k = 60
    measurement, truth = found[k]
    wrong = measurement.unstrained_length + np.array([0.5, 0.0, 0.0, 0.0])
    found[k] = (replace(measurement, unstrained_length=wrong), truth)
    errors, beliefs = believe(DynamicEstimator.build(robot), found)
    assert beliefs[-1].memory.outliers[0] == 1
    assert np.linalg.norm(errors[:, :3], axis=1).max() < 0.05


@pytest.mark.parametrize(("jump", "outliers"), [(0.05, 0), (0.02, 1)])
def test_a_length_that_jumps_farther_than_is_set_is_an_outlier(robot, jump, outliers):
    found = swing(robot, "lengths", PERFECT_SENSORS, duration=0.5)  # at rest so far
    k = 10
    step = robot.speed_max[0] * PERIOD + 0.03
    wrong = found[k][0].unstrained_length + np.array([step, 0.0, 0.0, 0.0])
    found[k] = (replace(found[k][0], unstrained_length=wrong), found[k][1])
    settings = DynamicEstimatorSettings(reading_jump=jump)
    _, beliefs = believe(DynamicEstimator.build(robot, settings), found[: k + 3])
    assert beliefs[-1].memory.outliers[0] == outliers


@pytest.mark.parametrize(
    ("name", "channels"), [("vibration", slice(3, 6)), ("angular_vibration", slice(0, 3))]
)
def test_vibrations_are_noise_of_the_imu_that_more_samples_do_not_lower(robot, name, channels):
    noise = []
    for value in (0.0, 0.5):
        settings = settings_for(robot, DynamicEstimatorSettings(**{name: value}))
        model = DynamicModel(robot, settings)
        home = ct.statics.inverse_kinematics(robot, robot.home_position[None])
        length = home.unstrained_length[0]
        state = RestStart(robot, settings, model.errors).state(0.0, length)
        move = model.step(state, length, length, 0.01)
        felt = ImuMean(values=move.felt, samples=4)
        noise.append(np.diag(MeasurementModels(model, settings).felt(move, felt).noise))
    expected = np.zeros(6)
    expected[channels] = 0.5**2
    assert noise[1] - noise[0] == pytest.approx(expected, abs=1e-12)


def test_process_noise_and_wind_make_the_predicted_twist_less_certain(robot):
    """Over a second at rest, without anything that could correct it."""
    lengths = ct.statics.inverse_kinematics(robot, robot.home_position[None]).unstrained_length

    def deviation(**changes):
        estimator = DynamicEstimator.build(robot, DynamicEstimatorSettings(**changes))
        belief = estimator.reset(Measurement(time=np.zeros(1), unstrained_length=lengths))
        for k in range(1, 51):
            now = Measurement(time=np.full(1, k * PERIOD), unstrained_length=lengths)
            command = Command(time=now.time, unstrained_length=lengths)
            belief = estimator.update(belief, command, now)
        return np.sqrt(np.trace(belief.covariance[0, 6:9, 6:9]))

    usual = deviation()
    assert deviation(acceleration_noise=0.2) > 1.5 * usual
    assert deviation(wind_force=10.0) > 1.5 * usual
    assert deviation(wind_time=0.01) < usual  # a gust that is over at once moves it less


def test_a_light_platform_of_the_same_drag_is_expected_in_the_same_wind(robot):
    def expected(robot, **changes):
        return settings_for(robot, DynamicEstimatorSettings(**changes)).wind_force

    light = replace(robot, mass=0.2 * robot.mass)
    assert expected(robot) == 3.0
    assert expected(light) == pytest.approx(3.0)
    assert expected(replace(light, drag=0.0)) == pytest.approx(0.6)  # in parts of the weight
    assert expected(replace(robot, drag=2.0 * robot.drag)) == pytest.approx(6.0)
    assert expected(light, wind_force=0.1) == 0.1  # what the user says
    scampi = ct.load_robot("scampi")  # of the drag of carosac, at a fifth of its weight
    assert expected(scampi) >= 3.0 * find_condition("nominal-1").of(scampi).wind_force


def test_innovations_beyond_the_gate_count_as_disturbed(robot):
    found = swing(robot, "lengths+imu", SensorSettings(), duration=1.0)

    def disturbed(gate):
        settings = DynamicEstimatorSettings(gate=gate)
        _, beliefs = believe(DynamicEstimator.build(robot, settings), found)
        return sum(belief.innovations.rejected[0] for belief in beliefs)

    assert disturbed(6.0) < 3 and disturbed(0.02) > 20


def test_an_encoder_that_slips_moves_nothing(robot):
    """No winch is that fast: the step, there and back after a second, is in the reading alone."""
    found = swing(robot, "lengths", SensorSettings(encoder_bias=0.0), duration=2.5)
    clean, _ = believe(DynamicEstimator.build(robot), found)
    for k in range(50, 100):
        measurement, truth = found[k]
        wrong = measurement.unstrained_length + np.array([0.0, 0.2, 0.0, 0.0])
        found[k] = (replace(measurement, unstrained_length=wrong), truth)
    errors, beliefs = believe(DynamicEstimator.build(robot), found)
    assert beliefs[99].memory.slips[0] == 1 and beliefs[-1].memory.slips[0] == 2
    assert beliefs[-1].memory.outliers[0] == 8
    assert rms(errors) < rms(clean) + 0.01
    bias = beliefs[99].memory.tracks[0].state.length_bias
    assert bias == pytest.approx([0.0, 0.2, 0.0, 0.0], abs=0.01)


def test_an_encoder_that_slipped_before_a_gap_has_slipped_after_it(robot):
    """Hung anew, the platform hangs on the lengths without the slip."""
    found = swing(robot, "lengths", SensorSettings(encoder_bias=0.0), duration=2.0)
    slip = np.array([0.0, 0.2, 0.0, 0.0])
    for k in range(50, len(found)):
        measurement, truth = found[k]
        wrong = replace(measurement, unstrained_length=measurement.unstrained_length + slip)
        found[k] = (wrong, truth)
    estimator = DynamicEstimator.build(robot)
    _, beliefs = believe(estimator, found)
    rest = ct.statics.inverse_kinematics(robot, robot.home_position[None])
    late = Measurement(time=np.full(1, 100.0), unstrained_length=rest.unstrained_length + slip)
    command = Command(time=np.zeros(1), unstrained_length=rest.unstrained_length)
    hung = estimator.update(beliefs[-1], command, late)
    assert hung.position[0] == pytest.approx(robot.home_position, abs=0.01)
    assert hung.memory.tracks[0].state.length_bias == pytest.approx(slip, abs=0.01)


def test_an_encoder_that_comes_free_is_believed(robot):
    """It stood still exactly, and then jumps to where it should be: that is no slip."""
    found = swing(robot, "lengths", SensorSettings(encoder_bias=0.0), duration=2.5)
    for k in range(30, 70):
        measurement, truth = found[k]
        length = measurement.unstrained_length.copy()
        length[:, 0] = found[30][0].unstrained_length[:, 0]
        found[k] = (replace(measurement, unstrained_length=length), truth)
    _, beliefs = believe(DynamicEstimator.build(robot), found)
    bias = beliefs[-1].memory.tracks[0].state.length_bias
    assert beliefs[-1].memory.slips[0] == 0 and bias == pytest.approx(0.0, abs=1e-9)


def test_lengths_that_lead_the_poses_are_waited_for(robot):
    """A robot whose readings lead by 60 ms: the belief is where the platform is, not will be."""
    found = swing(robot, "lengths", PERFECT_SENSORS, duration=3.0)
    early = [
        (replace(found[k + 3][0], time=measurement.time, length_rate=None), truth)
        for k, (measurement, truth) in enumerate(found[:-3])
    ]
    # A driver's readings come 10 ms late, so three cycles ahead is a lead of 50 ms.
    lead = replace(robot, length_delay=0.05)
    honest, _ = believe(DynamicEstimator.build(lead), early)
    hasty, _ = believe(DynamicEstimator.build(robot), early)
    assert rms(honest) < 0.3 * rms(hasty)


@pytest.mark.parametrize(("gap_max", "restarts"), [(60.0, 1), (120.0, 0)])
def test_after_a_gap_the_platform_is_hung_anew_and_that_is_counted(robot, gap_max, restarts):
    rest = ct.statics.inverse_kinematics(robot, robot.home_position[None])
    lengths = rest.unstrained_length
    estimator = DynamicEstimator.build(robot, DynamicEstimatorSettings(gap_max=gap_max))
    belief = estimator.reset(Measurement(time=np.zeros(1), unstrained_length=lengths))
    late = Measurement(time=np.full(1, 100.0), unstrained_length=lengths * 1.001)
    after = estimator.update(
        belief, Command(time=np.zeros(1), unstrained_length=lengths), late
    )  # fmt: skip
    hung = ct.statics.forward_kinematics(robot, lengths * 1.001)
    assert after.memory.restarts[0] == restarts
    if restarts:
        assert after.position == pytest.approx(hung.position, abs=1e-6)


@pytest.mark.parametrize(
    ("name", "value"),
    [("length_bias", -1.0), ("wind_time", 0.0), ("gate", np.nan), ("imu_position", (0.0, 1.0))],
)
def test_settings_that_make_no_sense_are_refused(name, value):
    with pytest.raises(InvalidField, match=name):
        DynamicEstimatorSettings(**{name: value})


def test_poses_newer_than_the_lengths_wait_for_them(robot):
    """Motion capture without delay, encoders 10 ms late: no pose is lost."""
    fresh = replace(PERFECT_SENSORS, pose_delay=0.0, encoder_delay=0.01, encoder_bias=0.01)
    found = swing(robot, "lengths+pose", fresh, duration=3.0)
    errors, beliefs = believe(DynamicEstimator.build(robot), found)
    assert sum(belief.innovations.dof[0] for belief in beliefs) > 6 * 0.9 * len(found)
    assert rms(errors[50:]) < 3e-3


def test_late_poses_count_for_less_and_too_late_ones_not_at_all(robot):
    def late(delay):
        sensors = replace(PERFECT_SENSORS, pose_delay=delay)
        found = swing(robot, "lengths+pose", sensors, duration=3.0)
        errors, beliefs = believe(DynamicEstimator.build(robot), found)
        return rms(errors[50:]), sum(b.innovations.rejected[0] for b in beliefs)

    error, rejected = late(0.06)
    assert error < 8e-3 and rejected == 0
    error, rejected = late(0.3)
    assert error < 0.02 and rejected > 50


def test_a_batch_is_as_its_rows_alone(robot):
    series = [swing(robot, "lengths+imu", SensorSettings(), seed=k, duration=1.0) for k in (0, 1)]
    alone = [believe(DynamicEstimator.build(robot), found)[1][-1] for found in series]
    both = DynamicEstimator.build(robot)
    belief = None
    for pair in zip(*series, strict=True):
        measurement = joined([one for one, _ in pair])
        command = Command(time=measurement.time, unstrained_length=measurement.unstrained_length)
        if belief is None:
            belief = both.reset(measurement)
        else:
            belief = both.update(belief, command, measurement)
    for row, one in enumerate(alone):
        assert belief.position[row] == pytest.approx(one.position[0], abs=1e-9)
        assert belief.covariance[row] == pytest.approx(one.covariance[0], rel=1e-6, abs=1e-12)


def joined(rows):
    """Measurements of several robots as one."""
    both = {"time": np.concatenate([row.time for row in rows])}
    both["unstrained_length"] = np.concatenate([row.unstrained_length for row in rows])
    for name in ("length_rate", "imu"):
        parts = [getattr(row, name) for row in rows]
        if parts[0] is not None:
            both[name] = type(parts[0])(
                **{key: np.concatenate([vars(p)[key] for p in parts]) for key in vars(parts[0])}
            )
    return Measurement(**both)


def test_lengths_that_stop_coming_are_held_and_doubted(robot):
    found = swing(robot, "lengths", PERFECT_SENSORS, duration=2.0)
    last = found[40][0]
    silent = found[:41] + [
        (replace(last, time=measurement.time), truth) for measurement, truth in found[41:]
    ]
    _, beliefs = believe(DynamicEstimator.build(robot), silent)
    assert beliefs[-1].memory.stale[0] >= 4
    sure, unsure = beliefs[40].covariance[0], beliefs[-1].covariance[0]
    assert unsure[0, 0] > 100.0 * sure[0, 0]
