import numpy as np
import pytest

from carosac_toolkit.live.hand_target import HandTarget
from carosac_toolkit.live.paced_path import PacedPath
from carosac_toolkit.live.sequence import Course
from carosac_toolkit.trajectories import line
from tests.robots import hanging, simple_robot

PERIOD, SLOW, FAST, ACCELERATION = 0.01, 0.05, 0.4, 0.5
START = np.array([0.0, -1.0, 2.0])


def followed(path, way):
    """Positions, velocities and accelerations of a path that is slow within a distance of START."""
    here = [START]
    start = PacedPath(
        path, slow=lambda: bool(np.linalg.norm(here[-1] - START) < way), slow_speed=SLOW,
        speed=FAST, acceleration=ACCELERATION,
    )  # fmt: skip
    velocity, acceleration = [], []
    for k in range(2000):
        reference = start.window(PERIOD * k, 0.1, PERIOD)
        assert reference.time[0] == pytest.approx(PERIOD * (k + np.arange(11)))
        here.append(reference.position[0, 0])
        velocity.append(reference.velocity[0, 0])
        acceleration.append(reference.acceleration[0, 0])
    return np.array(here[1:]), np.array(velocity), np.array(acceleration)


def test_the_first_way_is_gone_slowly_and_the_rest_as_fast_as_before():
    goal = START + np.array([0.0, 0.0, 1.5])
    path = line(START, goal, speed_max=FAST, acceleration_max=ACCELERATION)
    position, velocity, acceleration = followed(path, 0.1)
    speed = np.linalg.norm(velocity, axis=1)
    near = np.linalg.norm(position - START, axis=1) < 0.1
    assert speed[near].max() < SLOW * 1.01
    assert speed.max() == pytest.approx(FAST, rel=5e-3)
    assert position[-1] == pytest.approx(goal, abs=1e-9)
    moved = np.diff(position, axis=0) / PERIOD
    assert moved == pytest.approx(velocity[1:], abs=0.02)  # the velocity is that of the positions
    assert np.abs(np.diff(speed)).max() < 1.2 * ACCELERATION * PERIOD
    changed = np.diff(velocity, axis=0) / PERIOD
    assert changed == pytest.approx(acceleration[1:], abs=0.02)  # and so is the acceleration
    jerk = np.abs(np.diff(moved, n=2, axis=0)).max() / PERIOD**2
    assert jerk < 10.0 * ACCELERATION**2 / FAST  # no step in the acceleration of the positions


@pytest.mark.parametrize("speed", [SLOW, FAST])
def test_a_path_that_stays_within_the_slow_way_is_gone_to_its_end(speed):
    goal = START + np.array([0.0, 0.0, 0.05])
    there_and_back = Course(
        [line(START, goal, speed_max=speed, acceleration_max=0.5),
         line(goal, START, speed_max=speed, acceleration_max=0.5)] * 5, rest=0.1,
    )  # fmt: skip
    paced = PacedPath(there_and_back, slow=lambda: True, slow_speed=SLOW, speed=speed)
    time, last = 0.0, None
    while paced.past_end < 1.0:
        last = paced.window(time, 0.0, PERIOD).position[0, 0]
        time += PERIOD
    assert last == pytest.approx(START, abs=1e-9)
    assert 10 * 0.05 / SLOW < time < paced.duration + 1.0


def test_a_hand_target_starts_slowly_too():
    hand = HandTarget(simple_robot(), START, speed_max=FAST, acceleration_max=ACCELERATION)
    hand.go_to(START + np.array([0.0, 1.0, 1.0]))
    position, velocity, _ = followed(hand, 0.1)
    near = np.linalg.norm(position - START, axis=1) < 0.1
    speed = np.linalg.norm(velocity, axis=1)
    assert speed[near].max() < SLOW * 1.01
    assert speed.max() > 0.9 * FAST
    assert position[-1] == pytest.approx(hand.target, abs=2e-3)


def test_a_hand_target_of_two_cables_stays_where_they_let_the_platform_rest():
    robot = hanging(2)
    hand = HandTarget(robot, robot.home_position, speed_max=FAST, acceleration_max=ACCELERATION)
    assert hand.go_to(np.array([0.3, 0.2, 2.5])) == pytest.approx([0.3, 0.0, 2.5], abs=1e-9)
    assert hand.target == pytest.approx([0.3, 0.0, 2.5], abs=1e-9)


@pytest.mark.parametrize("late", [0.004, 0.3], ids=["jitter", "missed cycles"])
def test_cycles_that_come_late_leave_no_trace_in_the_positions(late):
    path = line(START, START + np.array([0.0, 0.0, 1.5]), speed_max=FAST, acceleration_max=0.5)
    rng = np.random.default_rng(1)
    paced, clock, position = PacedPath(path), 0.0, []
    for _ in range(800):
        clock += PERIOD + late * rng.uniform() ** 8
        reference = paced.window(clock, 0.05, PERIOD)
        assert reference.time[0] == pytest.approx(clock + PERIOD * np.arange(6))
        position.append(reference.position[0, 0])
    expected = path.sample(PERIOD * np.arange(800)).position
    assert np.array(position) == pytest.approx(expected, abs=1e-9)


def test_the_same_time_once_more_is_the_same_reference():
    paced = PacedPath(line(START, START + np.ones(3), speed_max=FAST, acceleration_max=0.5))
    for k in range(100):
        first = paced.window(PERIOD * k, 0.0, PERIOD)
    assert paced.window(PERIOD * 99, 0.0, PERIOD).position == pytest.approx(first.position, abs=0)
