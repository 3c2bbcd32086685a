"""What the winches are sent: in time, and within limits."""

from __future__ import annotations

import numpy as np
import pytest

from baselines.mpc.winch_reference import WinchReference
from carosac_toolkit.loop.values import Command
from carosac_toolkit.safety.limiter import Limiter, LimitSettings
from tests.robots import simple_robot

H = 0.02


def reference(robot):
    winches = WinchReference(robot, period=H, jerk_max=200.0)
    winches.reset(np.full(4, 8.0))
    return winches


def test_a_lagging_winch_arrives_when_the_plan_says():
    robot = simple_robot()
    winches = reference(robot)
    omega, amplitude = 2.0, 0.3
    wound, errors = np.full(4, 8.0), []
    for k in range(200):
        t = (k + 1) * H
        length = 8.0 + amplitude * (1.0 - np.cos(omega * t)) * np.ones(4)
        command = winches.follow(length, amplitude * omega * np.sin(omega * t) * np.ones(4))
        wound = command + (wound - command) * np.exp(-H / robot.winch_lag)
        errors.append(np.abs(wound - length).max())
    assert max(errors[10:]) < 0.005 * amplitude * omega  # 5 ms late at most, of 60
    assert not winches.held


def test_the_drivers_limiter_has_nothing_to_change():
    robot = simple_robot()
    winches, rng = reference(robot), np.random.default_rng(0)
    limiter = Limiter(robot, LimitSettings(box=False), period=H)
    limiter.reset(np.full((1, 4), 8.0))
    held = 0
    for k in range(300):
        wish = rng.uniform(-20.0, 20.0) if k % 7 == 0 else -3.0 * winches.rate[0]
        command = winches.accelerate(np.full(4, wish))
        held += winches.held
        sent = limiter.apply(Command(time=[k * H], unstrained_length=command[None]))
        assert not sent.limited
    assert held > 10


def test_what_is_forced_stays_bounded():
    winches, rng = reference(simple_robot()), np.random.default_rng(1)
    for _ in range(2000):
        winches.follow(8.0 + rng.normal(size=4), rng.normal(size=4))
    assert np.abs(winches.rate).max() < 5.0


def test_the_range_of_accelerations_is_that_of_the_commands():
    winches = reference(simple_robot())
    for _ in range(5):
        winches.accelerate(np.full(4, 0.8))
    allowed = winches.acceleration_range()
    length, rate = winches.length.copy(), winches.rate.copy()
    lengths = winches.command_range()
    a = allowed.high
    command = winches.follow(length + H * rate + 0.5 * H * H * a, rate + H * a)
    assert command == pytest.approx(lengths.high, abs=1e-9)
