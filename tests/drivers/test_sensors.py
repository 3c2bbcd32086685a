from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.drivers.quasi_static import QuasiStaticDriver, QuasiStaticSettings
from carosac_toolkit.drivers.sensors import PERFECT_SENSORS, DelayLine, SensorSettings, quantised
from carosac_toolkit.loop.values import Command
from tests.robots import simple_robot


def readings(sensors, count=200, period=0.02, seed=0, suite="lengths"):
    """Measurements of a robot at rest, and its true lengths."""
    settings = QuasiStaticSettings(sensors=sensors, suite=suite, period=period)
    driver = QuasiStaticDriver.build(simple_robot(), settings, seed=seed)
    driver.connect()
    entries = [driver.measure()]
    hold = Command(time=np.zeros(1), unstrained_length=driver._command)
    for _ in range(count - 1):
        driver.command(hold)
        driver.wait(period)
        entries.append(driver.measure())
    return entries, driver.truth()


def lengths(result):
    return np.concatenate([m.unstrained_length for m in result])


def test_perfect_sensors_say_the_truth():
    result, truth = readings(PERFECT_SENSORS, count=5, suite="lengths+pose")
    assert lengths(result) == pytest.approx(np.tile(truth.unstrained_length, (5, 1)), abs=1e-12)
    assert result[-1].pose.position == pytest.approx(truth.position, abs=1e-9)
    assert result[-1].pose.rotation == pytest.approx(truth.rotation, abs=1e-9)
    assert result[-1].pose.time[0] == pytest.approx(result[-1].time[0])


def test_noise_has_its_standard_deviation_in_every_sample():
    result, truth = readings(replace(PERFECT_SENSORS, encoder_noise=2e-4), count=1000)
    error = lengths(result) - truth.unstrained_length
    assert error.std() == pytest.approx(2e-4, rel=5.0 / np.sqrt(2 * error.size))
    assert abs(error.mean()) < 5.0 * 2e-4 / np.sqrt(error.size)


def test_pose_noise_has_its_standard_deviation():
    sensors = replace(PERFECT_SENSORS, position_noise=1e-3, rotation_noise=5e-4)
    result, truth = readings(sensors, count=500, suite="lengths+pose")
    moved = np.concatenate([m.pose.position for m in result]) - truth.position
    turned = np.concatenate([m.pose.rotation for m in result]) @ truth.rotation[0].T
    skew = (turned - turned.swapaxes(1, 2)) / 2.0
    angle = np.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], axis=1)
    for error, deviation in ((moved, 1e-3), (angle, 5e-4)):
        assert error.std() == pytest.approx(deviation, rel=5.0 / np.sqrt(2 * error.size))


def test_bias_is_constant_in_a_run_and_differs_between_cables_and_seeds():
    biases = []
    for seed in range(60):
        result, truth = readings(replace(PERFECT_SENSORS, encoder_bias=5e-3), count=3, seed=seed)
        bias = lengths(result) - truth.unstrained_length
        assert np.ptp(bias, axis=0).max() < 1e-12
        biases.append(bias[0])
    drawn = np.array(biases)
    assert drawn.std() == pytest.approx(5e-3, rel=5.0 / np.sqrt(2 * drawn.size))
    assert np.abs(np.corrcoef(drawn.T) - np.eye(4)).max() < 5.0 / np.sqrt(60)


def test_readings_are_multiples_of_the_resolution():
    result, _ = readings(replace(PERFECT_SENSORS, encoder_noise=1e-3, encoder_resolution=5e-5))
    counts = lengths(result) / 5e-5
    assert np.abs(counts - counts.round()).max() < 1e-6
    assert quantised(np.array([1.24, -1.26]), 0.5).tolist() == [1.0, -1.5]
    assert quantised(np.array([1.24]), 0.0).tolist() == [1.24]


def test_samples_come_at_the_rate_of_the_sensor():
    result, _ = readings(replace(PERFECT_SENSORS, encoder_rate=10.0, encoder_noise=1e-3), count=101)
    changes = (np.diff(lengths(result)[:, 0]) != 0.0).sum()
    assert changes == 20  # 2 s
    stamps = np.array([m.length_rate.time[0] for m in result])
    assert np.unique(stamps) == pytest.approx(0.1 * np.arange(21))


def test_a_faster_camera_than_encoder_keeps_its_own_rate():
    sensors = replace(PERFECT_SENSORS, encoder_rate=50.0, pose_rate=400.0)
    result, _ = readings(sensors, count=3, period=0.0225, suite="lengths+pose")
    assert [m.pose.time[0] for m in result] == pytest.approx([0.0, 0.0225, 0.045])
    assert [m.length_rate.time[0] for m in result] == pytest.approx([0.0, 0.02, 0.04])


def test_readings_are_late_by_the_delay_and_say_when_they_were_taken():
    settings = QuasiStaticSettings(
        sensors=replace(PERFECT_SENSORS, encoder_delay=0.03), period=0.01
    )
    driver = QuasiStaticDriver.build(simple_robot(), settings)
    driver.connect()
    start = driver.measure().unstrained_length
    true, late = [], []
    for k in range(60):
        asked = start + 0.005 * (k // 2)
        driver.command(Command(time=np.zeros(1), unstrained_length=asked))
        true.append(driver.truth().unstrained_length[0])
        measurement = driver.measure()
        late.append(measurement.unstrained_length[0])
        taken = measurement.length_rate.time[0]
        assert taken == pytest.approx(max(measurement.time[0] - 0.03, 0.0), abs=1e-9)
        driver.wait(0.01)
    assert np.array(late[3:]) == pytest.approx(np.array(true[:-3]), abs=1e-12)
    assert late[0] == pytest.approx(start[0])


def test_delay_line_holds_samples_back():
    line = DelayLine(rate=10.0, delay=0.25)
    for k in range(6):
        assert line.due(0.1 * k)
        line.put(0.1 * k, np.array([float(k)]))
        assert not line.due(0.1 * k + 0.05)
    assert line.next_due == pytest.approx(0.6)
    assert line.newest(0.1)[1][0] == 0.0  # nothing has arrived: at rest before time 0
    assert line.newest(0.349)[1][0] == 0.0
    assert line.newest(0.35)[1][0] == 1.0  # taken at 0.1 s, here 0.25 s later
    assert line.newest(0.5) == (pytest.approx(0.2), pytest.approx([2.0]))
    assert line.newest(9.0)[1][0] == 5.0


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("encoder_rate", 0.0),
        ("pose_rate", np.inf),
        ("encoder_noise", -1e-3),
        ("pose_delay", np.nan),
    ],
)
def test_impossible_sensors_are_refused(name, value):
    with pytest.raises(InvalidField, match=f"{name}: got .*; allowed: {name} >"):
        SensorSettings(**{name: value})


def test_the_rate_is_the_difference_of_two_readings_with_their_noise():
    result, _ = readings(replace(PERFECT_SENSORS, encoder_noise=2e-4), count=200)
    rates = np.array([m.length_rate.value[0] for m in result[2:]])
    assert rates.std() == pytest.approx(np.sqrt(2.0) * 2e-4 * 100.0, rel=0.1)
