from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.drivers import ticks
from carosac_toolkit.drivers.quasi_static import (
    QuasiStaticDriver,
    QuasiStaticPlant,
    QuasiStaticSettings,
)
from carosac_toolkit.drivers.sensors import PERFECT_SENSORS, SensorSettings
from carosac_toolkit.drivers.simulated import SimulatedDriver, SimulatedSettings
from carosac_toolkit.loop.values import Command
from carosac_toolkit.physics.motion.winch import WinchSettings
from tests.plants import TurningPlant
from tests.robots import simple_robot

PERIOD = 0.02
STARTS = ((0.4, -1.8, 2.2), (0.9, -1.2, 2.6), (-0.3, -2.0, 1.8))


class WallClock:
    """A wall clock that a test winds on; sleeping takes as long as it says."""

    def __init__(self):
        self.now = 100.0
        self.slept = []

    def monotonic(self):
        return self.now

    def sleep(self, duration):
        self.slept.append(duration)
        self.now += duration


@pytest.fixture
def clock(monkeypatch):
    result = WallClock()
    monkeypatch.setattr(ticks, "time", result)
    return result


def statics_of(size, seed=0, **changes):
    settings = QuasiStaticSettings(**changes)
    plant = QuasiStaticPlant(simple_robot(), settings.winch, size=size)
    driver = QuasiStaticDriver(plant, settings, seed)
    driver.connect()
    return driver


def turning(size=1, **changes):
    plant = TurningPlant(size=size)
    driver = SimulatedDriver(plant, SimulatedSettings(**changes))
    driver.connect()
    return driver, plant


def play(driver, changes):
    """Ask for a step of the lengths each cycle; measurements and truths after them."""
    first = driver.measure().unstrained_length
    entries = []
    for change in changes:
        now = driver.measure().time
        driver.command(Command(time=now, unstrained_length=first + change))
        driver.wait(PERIOD)
        entries.append((driver.measure(), driver.truth()))
    return entries


def test_a_batch_is_the_same_as_a_loop():
    rng = np.random.default_rng(1)
    changes = 0.05 * rng.standard_normal((15, 3, 4))
    together = play(
        statics_of(3, sensors=PERFECT_SENSORS, suite="lengths+pose", start_position=STARTS), changes
    )
    for b in range(3):
        alone = play(
            statics_of(1, sensors=PERFECT_SENSORS, suite="lengths+pose", start_position=STARTS[b]),
            changes[:, b : b + 1],
        )
        for (many, state), (one, truth) in zip(together, alone, strict=True):
            assert many.unstrained_length[b] == pytest.approx(one.unstrained_length[0], abs=1e-12)
            assert many.pose.position[b] == pytest.approx(one.pose.position[0], abs=1e-9)
            assert state.position[b] == pytest.approx(truth.position[0], abs=1e-9)
            assert state.tension[b] == pytest.approx(truth.tension[0], abs=1e-5)


def test_robots_start_at_one_place_each_or_all_at_one():
    assert statics_of(3).truth().position == pytest.approx(
        np.tile(simple_robot().home_position, (3, 1)), abs=1e-9
    )
    same = statics_of(2, start_position=STARTS[1]).truth().position
    assert same == pytest.approx(np.tile(STARTS[1], (2, 1)), abs=1e-9)
    assert statics_of(3, start_position=STARTS).truth().position == pytest.approx(
        np.array(STARTS), abs=1e-9
    )


@pytest.mark.parametrize(
    ("start", "message"),
    [
        (STARTS[:2], r"start_position: got shape \(2, 3\); allowed: shape \(3, 3\)"),
        ((0.0, 1.0), r"start_position: got shape \(2,\); allowed: shape \(3,\)"),
        ((0.0, 1.0, np.nan), r"start_position\[2\]: got nan"),
        ("here", r"start_position: got 'here'; allowed: numbers"),
        (
            (*STARTS[:2], (0.4, -1.8, 9.5)),
            r"start_position\[2\]: got .*a position with an equilibrium \(",
        ),
    ],
)
def test_starts_that_cannot_be_are_refused(start, message):
    with pytest.raises(InvalidField, match=message):
        statics_of(3, start_position=start)


def test_the_plant_is_advanced_from_sample_to_sample():
    sensors = replace(PERFECT_SENSORS, encoder_rate=100.0, imu_rate=200.0)
    driver, plant = turning(size=2, suite="lengths+imu", sensors=sensors)
    driver.wait(PERIOD)
    assert [h for _, h in plant.commands] == pytest.approx([0.005] * 4)
    assert driver.measure().imu.time[1] == pytest.approx(0.005 * np.arange(5))
    assert driver.truth().time == pytest.approx([PERIOD] * 2)


def test_winches_are_asked_for_what_their_own_encoders_say():
    sensors = replace(PERFECT_SENSORS, encoder_bias=5e-3)
    driver, plant = turning(size=2, sensors=sensors)
    start = driver.measure().unstrained_length
    assert np.abs(start - plant.length_at(plant.clocks())).max() > 1e-3
    driver.wait(PERIOD)  # nothing was commanded: the winches are to stay where they are
    assert plant.commands[0][0] == pytest.approx(plant.length_at(0.1 * np.arange(2)), abs=1e-12)


def test_a_misjudged_drum_is_seen_in_truth_and_not_by_the_encoders():
    robot = simple_robot(drum_radius=[0.075] * 4, drum_buildup=[7e-5] * 4)
    settings = QuasiStaticSettings(
        sensors=PERFECT_SENSORS, winch=WinchSettings(believed_drum_buildup=6.5e-5)
    )
    driver = QuasiStaticDriver.build(robot, settings)
    driver.connect()
    read, true = driver.measure().unstrained_length, driver.truth().unstrained_length
    result = play(driver, np.minimum(0.01 * np.arange(80), 0.4)[:, None, None] * np.ones((1, 4)))
    measured, state = result[-1]
    assert measured.unstrained_length == pytest.approx(read + 0.4, abs=1e-4)
    # an encoder's reading per true length is the ratio of the radii at equal angle
    moved = state.unstrained_length - true
    at = np.sqrt(0.075**2 - 7e-5 * (true + 0.5 * moved))
    believed = np.sqrt(0.075**2 - 6.5e-5 * (read + 0.2))
    assert moved / 0.4 == pytest.approx(at / believed, abs=2e-4)
    assert (moved < 0.399).all()


def test_an_unknown_suite_is_refused_and_each_driver_says_what_it_has():
    with pytest.raises(InvalidField, match=r"suite: got 'imu'; .*\+inclination, in this order$"):
        SimulatedSettings(suite="imu")
    with pytest.raises(InvalidField, match=r"sensors: got \{'swivel': True\}; .*SensorSettings"):
        SimulatedSettings(sensors={"swivel": True})
    with pytest.raises(InvalidField, match="real_time: got 'yes'; allowed: True or False"):
        SimulatedSettings(real_time="yes")


def test_real_time_waits_for_the_ticks_of_a_schedule_that_does_not_drift(clock):
    driver, _ = turning(sensors=PERFECT_SENSORS, real_time=True)
    rng = np.random.default_rng(0)
    for k in range(1, 200):
        clock.now += 0.9 * PERIOD * rng.random()  # what the cycle takes
        driver.wait(PERIOD)
        assert clock.now == pytest.approx(100.0 + k * PERIOD, abs=1e-9)
    assert driver.overruns == 0


def test_missed_ticks_are_counted_and_not_made_up_by_a_burst(clock):
    driver, _ = turning(sensors=PERFECT_SENSORS, real_time=True)
    driver.wait(PERIOD)
    clock.now += 2.4 * PERIOD  # the ticks 2 and 3 pass
    driver.wait(PERIOD)
    assert clock.now == pytest.approx(100.0 + 4 * PERIOD)
    assert driver.overruns == 2
    for k in (5, 6):
        driver.wait(PERIOD)
        assert clock.now == pytest.approx(100.0 + k * PERIOD)
    assert driver.overruns == 2
    assert driver.measure().time[0] == pytest.approx(4 * PERIOD)  # one period a cycle
    driver.connect()
    assert driver.overruns == 0


def test_without_real_time_nobody_sleeps(clock):
    driver, _ = turning(sensors=PERFECT_SENSORS)
    for _ in range(3):
        driver.wait(PERIOD)
    assert clock.slept == []


def test_real_time_is_real():
    import time

    driver, _ = turning(sensors=PERFECT_SENSORS, real_time=True)
    began = time.monotonic()
    for _ in range(5):
        driver.wait(PERIOD)
    assert time.monotonic() - began > 4 * PERIOD


def test_a_limit_holds_for_each_robot():
    driver = statics_of(3, sensors=SensorSettings(), seed=2)
    first = driver.measure().unstrained_length
    far = first + np.array([[0.0], [1.0], [0.0]])
    sent = driver.command(Command(time=np.zeros(3), unstrained_length=far))
    assert np.abs(sent.unstrained_length - first)[1].max() < 0.01
    assert {"jerk", "acceleration"} <= {hit.limit for hit in sent.limited}
