"""Lengths as a path in time, and the motion that they cause."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import carosac_toolkit as ct
from calibration.identification.open_loop import simulate
from calibration.identification.settings import IdentificationSettings
from calibration.identification.unknowns import choose_coordinates
from carosac_toolkit.base.errors import CarosacError
from carosac_toolkit.loop.values import Command
from carosac_toolkit.recordings.length_path import LengthPath
from carosac_toolkit.recordings.recording import Recording
from sim_warp.estimator import SimulatorEstimator, SimulatorSettings


@pytest.fixture(scope="module")
def robot():
    return ct.load_robot("carosac")


@pytest.fixture(scope="module")
def swinging(robot):
    """A move of 0.4 m in 2 s and a rest, sampled at 50 Hz."""
    time = np.arange(0.0, 5.0, 0.02)
    share = np.clip(time / 2.0, 0.0, 1.0)
    share = share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
    position = robot.home_position + share[:, None] * [0.3, 0.2, 0.15]
    lengths = ct.statics.inverse_kinematics(robot, position).unstrained_length
    return Recording(time=time, unstrained_length=lengths)


def moved(robots, recording, time):
    return simulate(robots, LengthPath(recording), time, time_step=1.0 / 140.0)


def test_smoothing_takes_noise_and_leaves_motion(swinging):
    rng = np.random.default_rng(0)
    lengths = swinging.unstrained_length
    assert LengthPath(swinging).at(swinging.time) == pytest.approx(lengths, abs=2e-5)
    noisy = replace(swinging, unstrained_length=lengths + 2e-4 * rng.standard_normal(lengths.shape))
    left = LengthPath(noisy).at(swinging.time) - lengths
    assert np.sqrt((left**2).mean()) < 1e-4  # of 2e-4


def test_the_motion_is_that_of_the_estimator_simulator(robot, swinging):
    settings = SimulatorSettings(cables="catenary", time_step=1.0 / 140.0)
    estimator = SimulatorEstimator.build(robot, settings)
    belief = estimator.reset(swinging.measurement(0))
    for k in range(1, len(swinging.time)):
        measurement = swinging.measurement(k)
        command = Command(time=measurement.time, unstrained_length=measurement.unstrained_length)
        belief = estimator.update(belief, command, measurement)
    motion = moved([robot], swinging, swinging.time)
    assert motion.position[-1, 0] == pytest.approx(belief.position[0], abs=3e-4)
    assert motion.rotation[-1, 0] == pytest.approx(belief.rotation[0], abs=2e-3)


def test_readings_of_a_scaled_and_shifted_sensor_move_the_robot_alike(robot, swinging):
    odd = replace(robot, length_offset=np.full(4, 0.3), length_scale=np.full(4, 1.01))
    readings = replace(swinging, unstrained_length=1.01 * swinging.unstrained_length + 0.3)
    time = swinging.time[::10]
    plain = moved([robot], swinging, time).position
    assert moved([odd], readings, time).position == pytest.approx(plain, abs=1e-6)


def test_a_delay_moves_the_motion_in_time(robot, swinging):
    late = replace(robot, length_offset=np.zeros(4), length_scale=np.ones(4), length_delay=0.1)
    time = swinging.time[:200:5]
    motion = moved([robot, late], swinging, np.union1d(time, time + 0.1))
    at = np.searchsorted(np.union1d(time, time + 0.1), time - 1e-9)
    later = np.searchsorted(np.union1d(time, time + 0.1), time + 0.1 - 1e-9)
    assert motion.position[later, 1] == pytest.approx(motion.position[at, 0], abs=1e-4)


def test_all_forces_and_masses_by_one_factor_give_the_same_motion(robot, swinging):
    """The search takes the derivatives by the mass from those by the others."""
    rubbing = replace(robot, exit_friction=np.full(4, 0.2), anchor_friction=np.full(4, 0.1))
    unknowns = choose_coordinates(rubbing, IdentificationSettings())
    assert unknowns.alike is not None
    larger = unknowns.robot_at(unknowns.alike)
    assert larger.mass == pytest.approx(np.e * robot.mass)
    motion = moved([rubbing, larger], swinging, swinging.time[::10])
    assert motion.position[:, 1] == pytest.approx(motion.position[:, 0], abs=1e-9)
    assert motion.rotation[:, 1] == pytest.approx(motion.rotation[:, 0], abs=1e-9)


def test_the_derivative_with_respect_to_a_parameter_exists(robot, swinging):
    """A millionth more mass moves the platform by millionths: no chaos, no noise of a solver."""
    time = swinging.time[::10]
    masses = [robot.mass * (1.0 + share) for share in (0.0, 1e-6, 1e-3)]
    motion = moved([replace(robot, mass=mass) for mass in masses], swinging, time)
    small = (motion.position[:, 1] - motion.position[:, 0]) / 1e-6
    large = (motion.position[:, 2] - motion.position[:, 0]) / 1e-3
    assert small == pytest.approx(large, abs=0.02 * np.abs(large).max())


def test_readings_that_mean_negative_lengths_are_refused(robot, swinging):
    odd = replace(robot, length_offset=np.full(4, 50.0))
    with pytest.raises(CarosacError, match="do readings and offsets belong"):
        moved([odd], swinging, swinging.time[:3])


def test_a_cable_that_stands_still_is_held_at_its_mean_and_a_slow_one_is_followed():
    rng = np.random.default_rng(3)
    time = np.arange(0.0, 5.0, 0.02)
    noise = 1e-4 * rng.standard_normal((len(time), 2))
    lengths = np.column_stack([np.full(len(time), 5.0), 5.0 + 4e-4 * time])
    path = LengthPath(Recording(time=time, unstrained_length=lengths + noise))
    seen = path.at(time)
    assert np.ptp(seen[:, 0]) < 1e-12
    assert seen[0, 0] == pytest.approx((lengths + noise)[:, 0].mean(), abs=1e-12)
    assert seen[:, 1] == pytest.approx(lengths[:, 1], abs=1e-4)
