from __future__ import annotations

from dataclasses import replace
from operator import attrgetter

import numpy as np
import pytest

from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.rotations import roll_and_pitch, to_matrix
from carosac_toolkit.drivers.quasi_static import QuasiStaticPlant
from carosac_toolkit.drivers.sensor_suite import SensorSuite
from carosac_toolkit.drivers.sensors import PERFECT_SENSORS, SENSOR_SUITES, SensorSettings
from carosac_toolkit.physics.cable.swivel import swivel_angle
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.robot.file import load_robot
from carosac_toolkit.robot.similar import similar_robot
from carosac_toolkit.robot.sizes import cable_size
from sim_warp.driver import SimPlant
from tests.plants import TurningPlant

ALL = "lengths+imu+pose"
LENGTH_ERRORS = ("encoder_noise", "encoder_resolution", "encoder_bias", "position_noise")
TENSION_ERRORS = ("tension_noise", "tension_bias")
NOISY = SensorSettings(tension=True)


def measured(suite, settings, *, plant=None, seed=0, period=0.02, count=50):
    """One measurement a period, of a plant that is advanced from sample to sample."""
    plant = plant or TurningPlant()
    plant.reset(None)
    sensors = SensorSuite(suite, settings, plant, seed)
    sensors.sample(plant, 0.0)
    now, result = 0.0, [sensors.measure(0.0)]
    for k in range(1, count):
        while now < k * period - 1e-9:
            step = min(sensors.next_due, k * period) - now
            plant.advance(None, step)
            now += step
            sensors.sample(plant, now)
        result.append(sensors.measure(now))
    return result


def inertial(result, channel):
    """All inertial samples of one channel in a row, shape (B, K, 3) or (B, K)."""
    return np.concatenate([getattr(m.imu, channel) for m in result if m.imu], axis=1)


def test_a_suite_has_its_sensors_and_no_others():
    for suite in SENSOR_SUITES:
        if "swivel" in suite:
            continue  # this plant has no pulleys
        result = measured(suite, PERFECT_SENSORS, count=2)[-1]
        assert (result.imu is not None) == ("imu" in suite)
        assert (result.pose is not None) == ("pose" in suite)
        assert (result.tension is not None) == ("tension" in suite)
        assert (result.attitude is not None) == ("attitude" in suite)
        assert (result.inclination is not None) == ("inclination" in suite)
        added = measured(suite, replace(NOISY, attitude=True, inclination=True), count=2)[-1]
        assert None not in (added.tension, added.attitude, added.inclination)


def test_an_imu_at_rest_feels_its_own_weight_upwards():
    measurement = measured(
        "lengths+imu", PERFECT_SENSORS, plant=TurningPlant(speed=0.0, spin=0.0), count=3
    )
    force = inertial(measurement, "specific_force")
    assert force == pytest.approx(np.tile([0.0, 0.0, 9.81], (1, force.shape[1], 1)), abs=1e-12)
    assert not inertial(measurement, "angular_rate").any()


def test_an_imu_is_the_second_derivative_of_the_pose():
    plant = TurningPlant(size=2)
    measurement = measured("lengths+imu", PERFECT_SENSORS, plant=plant)
    time, force, rate = (
        inertial(measurement, name) for name in ("time", "specific_force", "angular_rate")
    )
    h = 1e-4
    for b in range(2):
        clocks = time[b] + 0.1 * b
        past, here, ahead = (plant.position_at(clocks + d) for d in (-h, 0.0, h))
        turn = plant.rotation_at(clocks)
        in_world = (past - 2.0 * here + ahead) / h**2 + np.array([0.0, 0.0, 9.81])
        assert np.einsum("kij,kj->ki", turn, force[b]) == pytest.approx(in_world, abs=1e-6)
        change = (plant.rotation_at(clocks + h) - plant.rotation_at(clocks - h)) / (2.0 * h)
        skew = turn.swapaxes(1, 2) @ change  # R^T dR/dt
        seen = np.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], axis=1)
        assert rate[b] == pytest.approx(seen, abs=1e-6)


@pytest.mark.parametrize("delay", [0.0, 0.012])
def test_every_inertial_sample_is_measured_once_and_when_it_has_arrived(delay):
    measurement = measured(
        "lengths+imu",
        replace(PERFECT_SENSORS, imu_delay=delay),
        plant=TurningPlant(size=2),
        period=0.013,
    )
    stamps = inertial(measurement, "time")
    assert stamps[0] == pytest.approx(np.arange(stamps.shape[1]) / 200.0)
    assert np.array_equal(stamps[0], stamps[1])
    last = -1.0
    for m in measurement:
        for taken in [] if m.imu is None else m.imu.time[0]:
            assert last < taken + delay <= m.time[0] + 1e-9
        last = m.time[0] + 1e-9
    assert stamps[0, -1] > measurement[-1].time[0] - delay - 1 / 200.0


def test_without_a_new_inertial_sample_there_is_none():
    measurement = measured("lengths+imu", PERFECT_SENSORS, period=0.002, count=20)
    assert [m.imu is None for m in measurement[:6]] == [False, True, True, False, True, False]


def test_measuring_again_at_the_same_time_says_the_same():
    plant = TurningPlant()
    sensors = SensorSuite(ALL, NOISY, plant, 0)
    sensors.sample(plant, 0.0)
    assert sensors.measure(0.0) is sensors.measure(0.0)
    assert sensors.measure(0.0).imu is not None


def test_inertial_noise_and_bias_have_their_standard_deviations():
    settings = SensorSettings()
    still = TurningPlant(size=400, speed=0.0, spin=0.0)
    measurement = measured("lengths+imu", settings, plant=still, period=0.1, count=3)
    for channel, noise, bias, truth in (
        ("angular_rate", 3.5e-3, 5e-3, 0.0),
        ("specific_force", 0.017, 0.05, [0.0, 0.0, 9.81]),
    ):
        error = inertial(measurement, channel) - truth
        mean = error.mean(axis=1)
        spread = (error - mean[:, None]).std() * np.sqrt(error.shape[1] / (error.shape[1] - 1))
        assert spread == pytest.approx(noise, rel=5.0 / np.sqrt(2 * error.size))
        assert mean.std() == pytest.approx(bias, rel=5.0 / np.sqrt(2 * mean.size))
        assert abs(mean.mean()) < 5.0 * bias / np.sqrt(mean.size)


@pytest.mark.parametrize("suite", ["lengths+tension", "lengths+imu+tension"])
def test_load_cells_of_a_suite_are_those_of_the_setting(suite):
    """The suite and the setting name the same sensor with the same random stream."""
    named = measured(suite, SensorSettings(), count=5)
    added = measured(suite.removesuffix("+tension"), NOISY, count=5)
    for one, other in zip(named, added, strict=True):
        assert np.array_equal(one.tension.value, other.tension.value)
        assert np.array_equal(one.unstrained_length, other.unstrained_length)
        assert (one.imu is None) == (other.imu is None)


def test_tensions_have_noise_bias_rate_and_delay():
    plant = TurningPlant(size=200)
    exact = replace(PERFECT_SENSORS, tension=True, tension_rate=50.0, tension_delay=0.03)
    for m in measured("lengths", exact, plant=plant)[3:]:
        taken = m.tension.time
        assert m.time[0] - 0.05 < taken[0] <= m.time[0] - 0.03 + 1e-9
        truth = 100.0 + 10.0 * plant.length_at(taken + 0.1 * np.arange(200))
        assert m.tension.value == pytest.approx(truth, abs=1e-9)
    settings = replace(PERFECT_SENSORS, tension=True, tension_noise=2.0, tension_bias=4.0)
    measurement = measured("lengths", settings, plant=plant)
    truth = np.stack(
        [100.0 + 10.0 * plant.length_at(m.tension.time + 0.1 * np.arange(200)) for m in measurement]
    )
    error = np.stack([m.tension.value for m in measurement]) - truth
    assert error.std(axis=0, ddof=1).mean() == pytest.approx(2.0, rel=0.02)
    assert error.mean(axis=0).std() == pytest.approx(4.0, rel=5.0 / np.sqrt(2 * 800))


def turned(settings, *, size=1, **more):
    """Measurements of all sensors of turns on a platform that moves."""
    plant = TurningPlant(size=size, **more)
    return plant, measured("lengths+attitude+inclination", settings, plant=plant)


def test_an_ahrs_tells_turns_and_the_vertical_whatever_its_heading_and_mounting():
    askew = replace(PERFECT_SENSORS, attitude_mounting=0.1, attitude_heading=2.0)
    plant, result = turned(askew)
    said = np.concatenate([to_matrix(m.attitude.value) for m in result])
    true = plant.rotation_at(np.concatenate([m.attitude.time for m in result]))
    for name in ("up", "turn"):
        first, second = (
            each[:, 2] @ each[0, 2] if name == "up" else np.einsum("kij,ij->k", each, each[0])
            for each in (said, true)
        )
        np.testing.assert_allclose(first, second, atol=1e-9)
    assert np.abs(said[:, 2] - true[:, 2]).max() > 1e-3  # it is mounted askew


def test_perfect_sensors_of_turns_tell_the_rotation():
    plant, result = turned(PERFECT_SENSORS, size=2)
    for m in result[::7]:
        true = plant.rotation_at(m.attitude.time + 0.1 * np.arange(2))
        np.testing.assert_allclose(to_matrix(m.attitude.value), true, atol=1e-12)
        np.testing.assert_allclose(m.inclination.value, roll_and_pitch(true), atol=1e-12)


def test_sensors_of_turns_have_their_noise():
    settings = replace(PERFECT_SENSORS, attitude_noise=0.01, inclination_noise=0.02)
    _, result = turned(settings, size=200, speed=0.0, spin=0.0)
    vectors = np.concatenate([m.attitude.value[:, 1:] for m in result])  # half of the turns
    assert 2.0 * vectors.std() == pytest.approx(0.01, rel=0.02)
    tilts = np.concatenate([m.inclination.value for m in result])
    assert tilts.std() == pytest.approx(0.02, rel=0.02)


def test_scales_of_load_cells_are_off_in_proportion():
    plant = TurningPlant(size=300)
    m = measured(
        "lengths+tension", replace(PERFECT_SENSORS, tension_scale=0.1), plant=plant, count=2
    )[-1]
    true = 100.0 + 10.0 * plant.length_at(m.tension.time + 0.1 * np.arange(300))
    share = m.tension.value / true - 1.0
    assert share.std() == pytest.approx(0.1, rel=5.0 / np.sqrt(2 * share.size))
    again = measured(
        "lengths+tension", replace(PERFECT_SENSORS, tension_scale=0.1), plant=plant, count=30
    )[-1]
    later = 100.0 + 10.0 * plant.length_at(again.tension.time + 0.1 * np.arange(300))
    assert again.tension.value / later - 1.0 == pytest.approx(share)


@pytest.mark.parametrize("kind", ["simulator", "quasi_static"])
def test_swivel_encoders_see_where_cables_leave_their_pulleys(kind):
    robot = load_robot("warehouse")
    sensors = replace(PERFECT_SENSORS, swivel_bias=0.01)
    plant = QuasiStaticPlant(robot) if kind == "quasi_static" else SimPlant(robot)
    start = robot.home_position + np.array([0.5, -0.3, 0.0])
    plant.reset(start[None])
    suite = SensorSuite("lengths+swivel", sensors, plant, 0)
    suite.sample(plant, 0.0)
    rest = statics.inverse_kinematics(robot, start[None])
    off = suite.measure(0.0).swivel_angle.value - swivel_angle(robot, -rest.exit_tension)
    assert off.std() == pytest.approx(0.01, rel=0.6) and np.abs(off).max() < 0.04
    true = plant.swivel_angles()
    assert true == pytest.approx(swivel_angle(robot, -rest.exit_tension), abs=1e-6)


def test_swivel_angles_need_pulleys_and_a_plant_that_knows_them():
    with pytest.raises(InvalidField, match=r"suite: got 'lengths\+swivel'.*has no pulleys"):
        SensorSuite("lengths+swivel", PERFECT_SENSORS, TurningPlant(), 0)
    with pytest.raises(InvalidField, match=r"sensors.swivel: got True; .*has no pulleys"):
        SensorSuite("lengths", replace(PERFECT_SENSORS, swivel=True), TurningPlant(), 0)
    with pytest.raises(InvalidField, match="this plant has no swivel angles"):
        pulleys = replace(TurningPlant().robot, pulley_radius=np.full(4, 0.05))
        SensorSuite("lengths+swivel", PERFECT_SENSORS, TurningPlant(robot=pulleys), 0)


def test_another_sensor_changes_nothing_that_this_one_says():
    lone = measured("lengths", SensorSettings(), seed=7)
    posed = measured("lengths+pose", SensorSettings(), seed=7)
    full = measured(ALL, replace(NOISY, imu_rate=333.0, tension_rate=40.0), seed=7)
    for one, two, three in zip(lone, posed, full, strict=True):
        assert np.array_equal(one.unstrained_length, two.unstrained_length)
        assert np.array_equal(one.unstrained_length, three.unstrained_length)
        assert np.array_equal(one.length_rate.value, three.length_rate.value)
        # advanced in other steps, the clock of the plant differs by rounding
        assert two.pose.position == pytest.approx(three.pose.position, abs=1e-12)


def test_draws_of_encoders_and_motion_capture_are_those_of_always():
    plant = TurningPlant()
    sensors = SensorSuite(ALL, NOISY, plant, 11)
    bias, encoders, mocap = map(np.random.default_rng, np.random.SeedSequence(11).spawn(3))
    assert np.array_equal(sensors.encoder_bias, 5e-3 * bias.standard_normal((1, 4)))
    sensors.sample(plant, 0.0)
    measurement = sensors.measure(0.0)
    reading = plant.read_lengths() + sensors.encoder_bias + 0.2e-3 * encoders.standard_normal(4)
    assert measurement.unstrained_length == pytest.approx(
        np.round(reading / 5e-5) * 5e-5, abs=1e-12
    )
    moved = measurement.pose.position - plant.truth().position
    assert moved[0] == pytest.approx(1e-3 * mocap.standard_normal(6)[3:], abs=1e-15)


def test_robots_of_a_batch_have_errors_of_their_own():
    result = measured(ALL, NOISY, plant=TurningPlant(size=3, speed=0.0, spin=0.0), count=5)[-1]
    off = result.unstrained_length - TurningPlant(size=3).read_lengths()
    for value in (off, result.pose.position, result.imu.angular_rate[:, 0], result.tension.value):
        assert len(np.unique(value[:, 0])) == 3
    assert result.time.shape == (3,)


def test_a_plant_without_inertia_has_no_imu():
    refusal = r"suite: got .* any of \+pose, .* in this order; this plant has no inertia"
    with pytest.raises(InvalidField, match=refusal):
        SensorSuite("lengths+imu", PERFECT_SENSORS, QuasiStaticPlant(TurningPlant().robot), 0)
    with pytest.raises(
        InvalidField, match=r"suite: got 'pose'; allowed: 'lengths', then any of \+imu, "
    ):
        SensorSuite("pose", PERFECT_SENSORS, TurningPlant(), 0)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("imu_rate", 0.0), ("angular_rate_noise", -1.0), ("specific_force_bias", np.nan),
        ("imu_delay", -0.1), ("tension_rate", 0.0), ("tension_noise", -1.0), ("tension", 1),
        ("angular_rate_bias", -1.0), ("swivel", 1), ("attitude", None), ("inclination_rate", 0.0),
        ("swivel_noise", -1.0), ("attitude_heading", np.inf), ("tension_scale", -0.1),
    ],
)  # fmt: skip
def test_impossible_numbers_are_refused(name, value):
    with pytest.raises(InvalidField, match=f"^{name}: got .*; allowed: "):
        SensorSettings(**{name: value})


def test_noise_and_bias_that_are_named_like_rates_may_be_zero():
    assert SensorSettings(angular_rate_noise=0.0, angular_rate_bias=0.0).angular_rate_bias == 0.0


def set_down_anew(rows, *, imu_delay=0.0):
    """Measurements of three moving robots each 25 ms; some are set down anew after 75 ms."""
    settings = replace(
        NOISY, encoder_noise=0.0, position_noise=0.0, rotation_noise=0.0, angular_rate_noise=0.0,
        specific_force_noise=0.0, tension_noise=0.0, imu_delay=imu_delay, encoder_delay=0.02,
    )  # fmt: skip
    plant = TurningPlant(size=3)
    plant.reset(None)
    sensors = SensorSuite(ALL, settings, plant, 4)
    sensors.sample(plant, 0.0)
    now, result = 0.0, []
    for k in range(1, 9):
        while now < 0.025 * k - 1e-9:
            step = min(sensors.next_due, 0.025 * k) - now
            plant.advance(None, step)
            now += step
            sensors.sample(plant, now)
        result.append(sensors.measure(now))
        if k == 3 and rows is not None:
            sensors.renew(np.array(rows))
            sensors.restart(np.array(rows), plant, now)
            result.append(sensors.measure(now))
    return result, sensors


def biases(sensors):
    return sensors.encoder_bias, sensors._tension_bias, sensors._imu_bias


@pytest.mark.parametrize("imu_delay", [0.0, 0.012])
def test_a_robot_that_is_set_down_anew_leaves_the_sensors_of_others_alone(imu_delay):
    alone, one = set_down_anew(None, imu_delay=imu_delay)
    result, other = set_down_anew([1], imu_delay=imu_delay)
    fresh = result.pop(3)
    for mine, theirs in zip(biases(one), biases(other), strict=True):
        np.testing.assert_array_equal(mine[[0, 2]], theirs[[0, 2]])
        assert (mine[1] != theirs[1]).all()
    for a, b in zip(alone, result, strict=True):
        for channel in ("unstrained_length", "length_rate.value", "pose.position", "tension.value",
                        "imu.angular_rate", "imu.specific_force"):  # fmt: skip
            first, second = (attrgetter(channel)(x) for x in (a, b))
            np.testing.assert_array_equal(first[[0, 2]], second[[0, 2]])
    assert (fresh.imu is None) == (imu_delay > 0.0)  # its samples are on the way
    assert not fresh.length_rate.value[1].any()


@pytest.mark.parametrize("factor", [0.1, 1.0, 10.0])
def test_default_errors_shrink_with_a_robot_but_do_not_grow(factor):
    known = default_errors(similar_robot(load_robot("carosac"), factor))
    for name, value in vars(SensorSettings()).items():
        power = 1 if name in LENGTH_ERRORS else 3 if name in TENSION_ERRORS else 0
        wanted = float(value) * min(factor, 1.0) ** power
        assert getattr(known, name) == pytest.approx(wanted, rel=1e-9), name


@pytest.mark.parametrize("name", ["carosac", "cogiro", "stadium"])
def test_default_errors_are_exactly_as_stated_on_carosac_and_larger_robots(name):
    assert vars(default_errors(load_robot(name))) == vars(SensorSettings())


def test_errors_that_a_user_sets_stay_on_a_small_robot():
    chosen = {name: 0.3 for name in (*LENGTH_ERRORS, *TENSION_ERRORS)}
    plant = TurningPlant(robot=load_robot("desktop"))
    suite = SensorSuite(ALL, SensorSettings(**chosen), plant, 0)
    assert {name: getattr(suite._settings, name) for name in chosen} == chosen


def test_the_bias_of_encoders_is_a_share_of_the_cables():
    small, base = load_robot("desktop"), load_robot("carosac")
    bias = [
        SensorSuite("lengths", SensorSettings(), TurningPlant(robot=robot), 3).encoder_bias
        for robot in (small, base)
    ]
    assert bias[0] / cable_size(small) == pytest.approx(bias[1] / cable_size(base), rel=1e-9)


def default_errors(robot):
    """The settings with which sensors of a robot are simulated by default."""
    return SensorSuite(ALL, SensorSettings(), TurningPlant(robot=robot), 0)._settings
