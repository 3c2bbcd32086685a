"""The controlled stop is the one its definition says, and looking ahead sees all of it."""

from __future__ import annotations

import numpy as np
import pytest

from carosac_toolkit.physics.cable.straight_line import inverse_kinematics
from carosac_toolkit.physics.motion.braking import Brakes, WinchMotion, most_steps
from tests.robots import simple_robot

ROBOT = simple_robot()
PERIOD, JERK = 0.01, 130.0
LIMITS = {"period": PERIOD, "jerk_max": JERK, "jump_max": 0.3}
RAMP = JERK * PERIOD  # largest change of acceleration in a period [m/s^2]


def motions(size: int) -> WinchMotion:
    """Random motions within speed and acceleration limits, far from all other limits."""
    rng = np.random.default_rng(2)
    speed = rng.uniform(-2.5, 2.5, (size, 4))
    acceleration = rng.uniform(-5.0, 5.0, (size, 4))
    return WinchMotion(np.full((size, 4), 15.0), speed, acceleration, np.zeros((size, 3)))


def left_over(speed: float, acceleration: float) -> float:
    """Speed once the acceleration was taken to zero, step by step."""
    while abs(acceleration) > RAMP:
        acceleration -= np.sign(acceleration) * RAMP
        speed += PERIOD * acceleration
    return speed


def defined_step(speed: float, acceleration: float) -> float:
    """The acceleration of the next step of the stop, by bisection of its definition."""
    low, high = max(acceleration - RAMP, -5.0), min(acceleration + RAMP, 5.0)
    for _ in range(80):
        middle = 0.5 * (low + high)
        if left_over(speed + PERIOD * middle, middle) > 0.0:
            high = middle
        else:
            low = middle
    return 0.5 * (low + high)


def test_the_controlled_stop_is_the_one_its_definition_says():
    brakes, motion = Brakes(ROBOT, 40, box=False, **LIMITS), motions(40)
    for _ in range(60):
        after = brakes.stop(motion)
        wanted = np.vectorize(defined_step)(motion.speed, motion.acceleration)
        assert after.acceleration == pytest.approx(wanted, abs=1e-9)
        assert after.speed == pytest.approx(motion.speed + PERIOD * wanted, abs=1e-11)
        motion = after


def test_the_stop_ends_exactly_at_rest_after_few_steps():
    brakes, motion = Brakes(ROBOT, 2000, box=False, **LIMITS), motions(2000)
    steps = 0
    while motion.speed.any() or motion.acceleration.any():
        motion, steps = brakes.stop(motion), steps + 1
        assert steps < most_steps(ROBOT, JERK, PERIOD)
    # ramps from +5 to -5 m/s^2 and back, and 2.5 m/s with what the first ramp adds
    assert steps * PERIOD < 3 * 5.0 / JERK + (2.5 + 5.0**2 / JERK) / 5.0 + 0.1


def test_looking_ahead_sees_the_extremes_of_the_stop():
    brakes, motion = Brakes(ROBOT, 50, box=False, **LIMITS), motions(50)
    inside = np.abs(motion.speed).max(axis=1) < 2.0
    ahead, lengths, speeds = brakes.look_ahead(motion), [motion.length], [np.abs(motion.speed)]
    for _ in range(200):
        motion = brakes.stop(motion)
        lengths.append(motion.length)
        speeds.append(np.abs(motion.speed))
    assert inside.any()
    assert (ahead.low == np.min(lengths, axis=0)).all()
    assert (ahead.high == np.max(lengths, axis=0)).all()
    assert (ahead.speed == np.max(speeds, axis=0)).all()


def test_looking_ahead_measures_the_distance_outside_the_box():
    brakes = Brakes(ROBOT, 1, box=True, **LIMITS)
    there = ROBOT.workspace_max[None] + [0.05, -1.0, -1.0]
    near = ROBOT.workspace_max[None] - [0.1, 1.0, 1.0]
    rest = np.zeros((1, 4))
    outside = brakes.look_ahead(
        WinchMotion(inverse_kinematics(ROBOT, there), rest, rest, near)
    ).outside
    assert outside == pytest.approx([0.05], abs=1e-9)
    inside = brakes.look_ahead(
        WinchMotion(inverse_kinematics(ROBOT, near), rest, rest, near)
    ).outside
    assert inside == pytest.approx([0.0], abs=0.0)
