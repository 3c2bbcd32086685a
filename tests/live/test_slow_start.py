import numpy as np
import pytest

from carosac_toolkit.live.hand_target import HandTarget
from carosac_toolkit.live.slow_start import SlowStart
from carosac_toolkit.trajectories import line
from tests.robots import simple_robot

PERIOD, SLOW, FAST, ACCELERATION = 0.01, 0.05, 0.4, 0.5
START = np.array([0.0, -1.0, 2.0])


def followed(path, way):
    """Positions and velocities of a path that is slow within a distance of where it starts."""
    here = [START]
    start = SlowStart(
        path, lambda: bool(np.linalg.norm(here[-1] - START) < way), speed=SLOW,
        acceleration=ACCELERATION, duration=30.0,
    )  # fmt: skip
    velocity = []
    for k in range(2000):
        reference = start.window(PERIOD * k, 0.1, PERIOD)
        assert reference.time[0] == pytest.approx(PERIOD * (k + np.arange(11)))
        here.append(reference.position[0, 0])
        velocity.append(reference.velocity[0, 0])
    return np.array(here[1:]), np.array(velocity)


def test_the_first_way_is_gone_slowly_and_the_rest_as_fast_as_before():
    goal = START + np.array([0.0, 0.0, 1.5])
    path = line(START, goal, speed_max=FAST, acceleration_max=ACCELERATION)
    position, velocity = followed(path, 0.1)
    speed = np.linalg.norm(velocity, axis=1)
    near = np.linalg.norm(position - START, axis=1) < 0.1
    assert speed[near].max() < SLOW + 2.0 * ACCELERATION * PERIOD
    assert speed.max() == pytest.approx(FAST, rel=1e-3)
    assert position[-1] == pytest.approx(goal, abs=1e-9)
    moved = np.diff(position, axis=0) / PERIOD
    assert moved == pytest.approx(velocity[1:], abs=0.02)  # the velocity is that of the positions
    assert np.abs(np.diff(speed)).max() < 2.5 * ACCELERATION * PERIOD


def test_a_hand_target_starts_slowly_too():
    hand = HandTarget(simple_robot(), START, speed_max=FAST, acceleration_max=ACCELERATION)
    hand.go_to(START + np.array([0.0, 1.0, 1.0]))
    position, velocity = followed(hand, 0.1)
    near = np.linalg.norm(position - START, axis=1) < 0.1
    speed = np.linalg.norm(velocity, axis=1)
    assert speed[near].max() < SLOW + 2.0 * ACCELERATION * PERIOD
    assert speed.max() > 0.9 * FAST
    assert position[-1] == pytest.approx(hand.target, abs=2e-3)
