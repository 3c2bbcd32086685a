from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio
import pytest

from carosac_toolkit.base.errors import CarosacError, InvalidField
from carosac_toolkit.drivers.sensors import PERFECT_SENSORS
from carosac_toolkit.loop.values import Command
from carosac_toolkit.physics.rest import statics
from sim_warp import SimDriver, SimDriverSettings, SimPlant, Simulator
from tests.robots import simple_robot

PERIOD = 0.02
STARTS = ((0.8, -1.0, 2.5), (0.4, -1.8, 2.2), (0.0, -2.6, 3.0))


def connected(settings=None, seed=0, **changes):
    chosen = settings or SimDriverSettings(sensors=PERFECT_SENSORS, **changes)
    driver = SimDriver.build(simple_robot(), chosen, seed=seed)
    driver.connect()
    return driver


def swing(driver, count, speed=0.4, turn=0.6):
    """Wind along x for `turn` seconds, then hold; measurements and truths at each cycle."""
    measured, truths = [driver.measure()], [driver.truth()]
    path = truths[0].position[:, None] + np.zeros((count, 3))
    path[..., 0] += speed * np.minimum(PERIOD * np.arange(1, count + 1), turn)
    size, n = truths[0].unstrained_length.shape
    rest = statics.inverse_kinematics(simple_robot(), path.reshape(-1, 3)).unstrained_length
    move = rest.reshape(size, count, n) - truths[0].unstrained_length[:, None]
    start = measured[0].unstrained_length
    for k in range(count):
        asked = Command(time=measured[-1].time, unstrained_length=start + move[:, k])
        driver.command(asked)
        driver.wait(PERIOD)
        measured.append(driver.measure())
        truths.append(driver.truth())
    return measured, truths


def column(truths, name):
    """A quantity of the first robot over time."""
    return np.array([getattr(truth, name)[0] for truth in truths])


def test_at_rest_the_imu_feels_gravity_along_the_tilted_platform():
    driver = connected(suite="lengths+imu", start_position=STARTS[0])
    for _ in range(5):
        driver.wait(PERIOD)
    imu, truth = driver.measure().imu, driver.truth()
    assert imu.specific_force.shape == (1, 21, 3)  # 0 to 0.1 s at 200 Hz
    up = truth.rotation[0].T @ [0.0, 0.0, 9.81]
    assert np.linalg.norm(up[:2]) > 0.5  # it hangs tilted
    # chains are set down within micrometres of rest; of 9.81 m/s^2 they feel what is left of that
    assert np.abs(imu.specific_force[0] - up).max() < 1e-3
    assert np.abs(imu.angular_rate).max() < 1e-3


@pytest.mark.parametrize("cables", ["particles", "catenary"])
def test_what_the_imu_feels_integrated_twice_is_where_the_platform_goes(cables):
    driver = connected(suite="lengths+imu", cables=cables)
    measured, truths = swing(driver, 50)
    samples = [m.imu for m in measured if m.imu is not None]
    time = np.concatenate([s.time[0] for s in samples])
    rate = np.concatenate([s.angular_rate[0] for s in samples])
    force = np.concatenate([s.specific_force[0] for s in samples])
    assert np.diff(time) == pytest.approx(0.005)
    position, rotation = truths[0].position[0], truths[0].rotation[0]
    velocity, gravity = np.zeros(3), np.array([0.0, 0.0, -9.81])
    for k, h in enumerate(np.diff(time)):
        before = rotation @ force[k] + gravity
        rotation = rotation @ pinocchio.exp3(0.5 * h * (rate[k] + rate[k + 1]))
        after = rotation @ force[k + 1] + gravity
        position = position + h * velocity + h**2 * (2.0 * before + after) / 6.0
        velocity = velocity + 0.5 * h * (before + after)
    moved = np.linalg.norm(column(truths, "position") - truths[0].position[0], axis=1)
    assert moved.max() > 0.1 and np.ptp(column(truths, "position")[25:], axis=0).max() > 0.02
    # samples of 5 ms resolve the stiff modes, of some 10 Hz, to a few per cent
    assert np.linalg.norm(position - truths[-1].position[0]) < 0.01 * moved.max()
    turned = pinocchio.log3(rotation.T @ truths[-1].rotation[0])
    assert np.linalg.norm(turned) < 2e-3
    assert velocity == pytest.approx(truths[-1].twist[0, :3], abs=0.01)


def test_the_twist_is_the_rate_of_the_pose():
    _, truths = swing(connected(), 40)
    position, twist = column(truths, "position"), column(truths, "twist")
    rate = (position[2:] - position[:-2]) / (2.0 * PERIOD)
    # of a mode at w, a difference over 2 h misses (w h)^2 / 6: of 1.5 Hz, 0.6 %
    assert np.abs(rate[:, 0] - twist[1:-1, 0]).max() < 0.02 * np.abs(twist[:, 0]).max()
    rotation = column(truths, "rotation")
    turns = [pinocchio.log3(b @ a.T) for a, b in zip(rotation[:-2], rotation[2:], strict=True)]
    spin = np.array(turns) / (2.0 * PERIOD)
    # and of the pitch at some 8 Hz, 17 %
    assert np.abs(spin - twist[1:-1, 3:]).max() < 0.2 * np.abs(twist[:, 3:]).max()


def test_encoders_say_the_wound_lengths_with_their_bias_some_time_later():
    sensors = replace(PERFECT_SENSORS, encoder_bias=0.01, encoder_delay=2.0 * PERIOD)
    driver = connected(SimDriverSettings(sensors=sensors), seed=3)
    measured, truths = swing(driver, 20)
    wound = column(truths, "unstrained_length")
    said = np.array([m.unstrained_length[0] for m in measured])
    bias = said[0] - wound[0]
    assert 1e-3 < np.abs(bias).max() < 0.05
    assert said[2:] - bias == pytest.approx(wound[:-2], abs=1e-12)
    assert np.abs(said[5] - bias - wound[5]).max() > 1e-3


def test_the_platform_still_swings_where_a_robot_without_inertia_rests():
    _, truths = swing(connected(), 200)
    still = column(truths, "unstrained_length")[100:]
    assert np.ptp(still, axis=0).max() < 1e-5
    rest = statics.forward_kinematics(simple_robot(), still[-1:]).position[0]
    x = column(truths, "position")[100:, 0] - rest[0]
    assert x.min() < -0.01 and x.max() > 0.01


@pytest.mark.parametrize("suite", ["lengths", "lengths+imu+pose"])
def test_three_at_once_are_three_alone(suite):
    together, truths = swing(connected(suite=suite, start_position=STARTS), 15)
    for b, start in enumerate(STARTS):
        alone, own = swing(connected(suite=suite, start_position=start), 15)
        assert np.array_equal(truths[-1].position[b], own[-1].position[0])
        for one, other in zip(together, alone, strict=True):
            assert np.array_equal(one.unstrained_length[b], other.unstrained_length[0])
            if other.imu is not None:
                assert np.array_equal(one.imu.specific_force[b], other.imu.specific_force[0])
            if other.pose is not None:
                assert np.array_equal(one.pose.rotation[b], other.pose.rotation[0])


def test_each_sensor_suite_sees_the_same_robot():
    lengths = []
    for suite in ("lengths", "lengths+imu", "lengths+pose", "lengths+imu+pose"):
        measured, _ = swing(connected(SimDriverSettings(suite=suite)), 10)
        assert (measured[-1].imu is not None) == ("imu" in suite)
        assert (measured[-1].pose is not None) == ("pose" in suite)
        lengths.append([m.unstrained_length for m in measured])
    assert all(np.allclose(other, lengths[0], rtol=0.0, atol=1e-9) for other in lengths[1:])


def test_wind_moves_the_platform_the_same_way_for_the_same_seed():
    def path(seed, **wind):
        driver = connected(seed=seed, **wind)
        for _ in range(50):
            driver.wait(PERIOD)
        first = driver.truth().position
        driver.close()
        driver.connect()
        for _ in range(50):
            driver.wait(PERIOD)
        assert np.array_equal(first, driver.truth().position)
        return first[0] - simple_robot().home_position

    calm, windy, again, other = path(1), path(1, wind_force=5.0), path(1, wind_force=5.0), path(
        2, wind_force=5.0
    )  # fmt: skip
    assert np.abs(calm).max() < 1e-5 < 1e-3 < np.abs(windy).max()
    assert np.array_equal(windy, again) and not np.array_equal(windy, other)


def test_wind_of_a_long_correlation_time_changes_slowly():
    def change(wind_time):
        """Change of the force of the wind in 20 ms over its standard deviation."""
        settings = SimDriverSettings(wind_force=5.0, wind_time=wind_time)
        plant = SimPlant(simple_robot(), settings, size=8)
        plant.reset(np.tile(simple_robot().home_position, (8, 1)))
        held, force = plant.read_lengths(), []
        for _ in range(100):
            plant.advance(held, PERIOD)
            force.append(plant.simulator.save().arrays["gusts"]["force"][:, :2] / 5.0)
        return np.diff(force, axis=0).std()

    for time in (0.2, 2.0, 20.0):  # [s]; interpolation between draws smooths the shortest one
        assert change(time) == pytest.approx(np.sqrt(2.0 * PERIOD / time), rel=0.15)


@pytest.mark.parametrize(
    "options",
    [{"cables": "catenary"}, {"segments": 5}, {"time_step": 1.0 / 240.0}, {"cable_drag": 3.0}],
    ids=lambda options: next(iter(options)),
)
def test_settings_of_the_cables_are_those_of_the_simulator(options):
    plant, default = (
        SimPlant(simple_robot(), SimDriverSettings(**changes)) for changes in (options, {})
    )
    simulator = Simulator(simple_robot(), **{"time_step": 5e-3, **options})
    rest = plant.read_lengths()
    for moved in (plant, default):
        moved.reset(np.array(STARTS[:1]))
        moved.advance(rest, 0.5)
    simulator.reset(STARTS[:1])
    simulator.step(rest, 0.5)
    there = simulator.state.numpy().position
    assert np.array_equal(plant.truth().position, there)
    assert np.abs(default.truth().position - there).max() > 1e-8


def test_a_device_that_is_not_there_is_refused():
    with pytest.raises(InvalidField, match=r"device: got 'cuda:99'; allowed: one of \['cpu'"):
        SimDriver.build(simple_robot(), SimDriverSettings(device="cuda:99"))


def test_drums_that_the_drives_misjudge_say_other_lengths_than_are_wound():
    from carosac_toolkit.physics.motion.winch import WinchBatch, WinchSettings

    robot = simple_robot(drum_radius=[0.05] * 4, drum_buildup=[3e-5] * 4)
    winch = WinchSettings(believed_drum_buildup=4e-5)
    driver = SimDriver.build(robot, SimDriverSettings(sensors=PERFECT_SENSORS, winch=winch))
    driver.connect()
    for _ in range(10):
        driver.wait(PERIOD)
    wound, said = driver.truth().unstrained_length, driver.measure().unstrained_length
    assert np.abs(said - wound).min() > 1e-3
    assert said == pytest.approx(WinchBatch(robot, wound, winch).read(), abs=1e-9)


def test_a_world_that_fails_is_named_with_the_time():
    plant = SimPlant(simple_robot(), size=3)
    plant.reset(np.array(STARTS))
    held = plant.read_lengths()
    plant.advance(held, 0.5)
    thrown = [[1e6, 0.0, 0.0, 0.0, 0.0, 0.0]]
    plant.simulator.reset(np.array(STARTS[1:2]), twist=thrown, worlds=[1])
    with pytest.raises(CarosacError, match=r"simulator: no finite motion in world 1 after 0\.0"):
        plant.advance(held, 0.1)


def test_a_start_where_it_cannot_rest_is_named():
    for start, name in (((0.4, -1.8, 30.0), "start_position"),
                        ((STARTS[0], (0.4, -1.8, 30.0)), r"start_position\[1\]")):  # fmt: skip
        with pytest.raises(InvalidField, match=rf"^{name}: got \[ ?0.4 +-1.8 +30. *\]"):
            connected(start_position=start)
    with pytest.raises(InvalidField, match="start_position"):
        connected(start_position=((0.0, 1.0), (2.0,)))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"cables": "ropes"}, r"cables: got 'ropes'; allowed: one of \['particles', 'catenary'"),
        ({"segments": 1}, "segments: got 1; allowed: a whole number from 2 to 256"),
        ({"time_step": 0.0}, "time_step: got 0.0 s; allowed: time_step > 0, finite"),
        ({"cable_drag": -1.0}, "cable_drag: got -1.0 1/s; allowed: cable_drag >= 0, finite"),
        ({"wind_force": float("nan")}, "wind_force: got nan N; allowed: wind_force >= 0"),
        ({"wind_time": 0.0}, "wind_time: got 0.0 s; allowed: wind_time > 0"),
        ({"suite": "imu"}, "suite: got 'imu'"),
    ],
)
def test_settings_that_cannot_be_are_named(changes, message):
    with pytest.raises(InvalidField, match=message):
        SimDriverSettings(**changes)
