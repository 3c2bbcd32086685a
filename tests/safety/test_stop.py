from __future__ import annotations

import numpy as np
import pytest

from carosac_toolkit import trajectories
from carosac_toolkit.loop.values import Command
from carosac_toolkit.physics.cable import straight_line
from carosac_toolkit.safety.limiter import Limiter, LimitSettings
from carosac_toolkit.safety.stop import CoordinatedStop
from tests.robots import simple_robot

ROBOT = simple_robot()
PATH = trajectories.build("circle", ROBOT, 0, speed_max=1.5, acceleration_max=2.0)


def moving(time, period, noise=0.0):
    """A limiter on a circle, its mean acceleration, and the positions of the circle."""
    rng = np.random.default_rng(1)
    positions = PATH.sample(np.arange(0.0, PATH.duration, period)).position
    lengths = straight_line.inverse_kinematics(ROBOT, positions)
    limiter = Limiter(ROBOT, LimitSettings(box=False), period=period)
    limiter.reset(lengths[:1])
    bend = np.zeros(ROBOT.n)
    for k in range(1, round(time / period)):
        asked = lengths[k] + noise * rng.normal(size=ROBOT.n)
        limiter.apply(Command(time=np.zeros(1), unstrained_length=asked[None]))
        bend += period / 0.1 * (limiter.motion.acceleration[0] - bend)
    return limiter, bend, positions


def stopped(limiter, stop):
    """Lengths of a whole stop, from the last ones before it, shape (T, n)."""
    entries = [limiter.motion.length[0]]
    while not limiter.stopped:
        entries.append(stop.step(np.zeros(1)).unstrained_length[0])
        assert len(entries) < 500
    return np.array(entries)


def off_path(lengths, positions):
    """Largest distance of the straight-line positions from the circle [m]."""
    fit = straight_line.forward_kinematics(ROBOT, lengths)
    far = np.linalg.norm(fit.position[:, None] - positions[None], axis=-1)
    return far.min(axis=1).max()


@pytest.mark.parametrize("period", [0.005, 0.01, 0.02])
@pytest.mark.parametrize("time", [1.5, 2.5, 3.5])
def test_the_stop_stays_on_the_path_within_all_limits(time, period):
    limiter, bend, positions = moving(time, period)
    before = limiter.motion
    stop = CoordinatedStop(limiter, bend)
    lengths = stopped(limiter, stop)
    assert stop.coordinated
    speed = np.diff(np.concatenate([lengths[:1] - before.speed * period, lengths]), axis=0) / period
    assert (np.abs(np.diff(speed, axis=0)) / period <= ROBOT.acceleration_max + 1e-6).all()
    jerk = np.diff(np.diff(speed, axis=0), axis=0) / period**2
    assert (np.abs(jerk) <= 200.0 + 1e-4).all()
    spacing = 1.5 * period
    assert off_path(lengths, positions) < 2e-3 + 0.5 * spacing
    assert straight_line.forward_kinematics(ROBOT, lengths).residual.max() < 1e-4


def test_it_keeps_closer_to_the_path_than_cables_that_brake_each_on_its_own_and_is_as_fast():
    limiter, bend, positions = moving(3.5, 0.01)
    together = stopped(limiter, CoordinatedStop(limiter, bend))
    alone, _, _ = moving(3.5, 0.01)
    each = [alone.motion.length[0]]
    while not alone.stopped:
        each.append(alone.brake().unstrained_length[0])
    assert off_path(together, positions) < 0.3 * off_path(np.array(each), positions)
    assert len(together) <= 1.2 * len(each)


def test_noise_in_the_commands_does_not_bend_the_path():
    limiter, bend, positions = moving(3.5, 0.01, noise=1e-4)
    assert off_path(stopped(limiter, CoordinatedStop(limiter, bend)), positions) < 0.02


def test_steps_that_the_limits_change_end_the_coordination_and_come_to_rest():
    """Near a length limit the path ahead is cut, and each cable brakes on its own."""
    limiter = Limiter(ROBOT, LimitSettings(box=False), period=0.01)
    lengths = np.array([[39.0, 20.0, 20.0, 20.0]])  # the first cable may be 40 m long
    limiter.reset(lengths)
    for _ in range(400):
        lengths = lengths + 0.02
        limiter.apply(Command(time=np.zeros(1), unstrained_length=lengths))
        if limiter.motion.length[0, 0] > 39.6:
            break
    stopped_run = stopped(limiter, CoordinatedStop(limiter, np.full(4, 4.9)))
    assert (stopped_run <= 40.0).all()


def test_at_rest_it_stays_where_it_is():
    limiter, _, _ = moving(0.02, 0.01)
    limiter.reset(limiter.motion.length)
    stop = CoordinatedStop(limiter)
    first = limiter.motion.length
    for _ in range(3):
        assert stop.step(np.zeros(1)).unstrained_length == pytest.approx(first, abs=0.0)
    assert limiter.stopped
