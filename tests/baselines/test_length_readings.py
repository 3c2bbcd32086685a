"""Lengths that no winch can have wound: outliers, slips, and what only looks like one."""

import numpy as np
import pytest

import carosac_toolkit as ct
from baselines.length_readings import LengthReadings, reading_tolerances

ROBOT = ct.load_robot("carosac")
TOLERANCES = reading_tolerances(ROBOT, 3e-4)
PERIOD, JUMP = 0.02, 0.05
SLIP = np.array([0.3, -0.25, 0.35, 0.03])


def wound(k: int, period: float = PERIOD) -> np.ndarray:
    """Lengths [m] while the winches wind at up to 1 m/s, with encoders that are a bit noisy."""
    noise = np.random.default_rng(k).normal(scale=3e-4, size=4)
    return 6.0 + np.array([0.5, -0.4, 0.3, 0.1]) * np.sin(2.0 * k * period) + noise


def heard(wrong, count: int = 200, period: float = PERIOD):
    """Readings k = 0 ... with what is wrong of each."""
    found = LengthReadings.first(0.0, wound(0, period) + wrong(0), TOLERANCES)
    for k in range(1, count):
        found = found.taken(k * period, wound(k, period) + wrong(k), ROBOT, JUMP, 0.0)
    return found


def between(first: int, last: int, offset):
    """The same offset from one reading to before another one."""
    return lambda k: offset if first <= k < last else np.zeros(4)


def test_winding_is_believed():
    found = heard(lambda k: np.zeros(4))
    assert found.rejected == 0 and not found.slid.any()


@pytest.mark.parametrize("period", [0.005, 0.02, 0.05])
def test_encoders_that_slip_are_noticed_those_that_slip_less_far_too(period):
    found = heard(lambda k: SLIP * (k >= 50), period=period)
    slipped = np.abs(SLIP) > (0.02 if period < 0.05 else 0.05)
    assert found.slid[slipped] == pytest.approx(SLIP[slipped], abs=0.02)
    assert found.rejected == 4


@pytest.mark.parametrize("length", [1, 3, 20, 60])
def test_a_fault_that_ends_leaves_nothing_behind(length):
    found = heard(between(50, 50 + length, SLIP))
    assert found.slid == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("length", [3, 7, 15, 25])
@pytest.mark.parametrize("cables", [(1, 1, 1, 1), (0, 1, 0, 0)])
def test_nonsense_that_ends_leaves_nothing_behind(length, cables):
    rng = np.random.default_rng(length)
    nonsense = rng.uniform(-1.0, 1.0, (300, 4)) * cables
    found = heard(lambda k: nonsense[k] if 50 <= k < 50 + length else np.zeros(4))
    assert found.slid == pytest.approx(0.0, abs=1e-12) and found.outliers is None


def test_of_two_jumps_the_second_counts():
    two, five = between(50, 52, np.full(4, 0.2)), between(52, 57, np.full(4, 0.5))
    found = heard(lambda k: two(k) + five(k))
    assert found.slid == pytest.approx(0.0, abs=1e-12)


def test_a_wrong_first_reading_is_no_slip_of_all_others():
    found = heard(between(0, 1, np.full(4, 0.3)))
    assert not found.slid.any() and found.outliers is None


def test_a_second_slip_much_later_is_one_of_its_own():
    found = heard(lambda k: SLIP * (k >= 50) - 0.8 * SLIP * (k >= 180), count=260)
    assert found.slid[:3] == pytest.approx(0.2 * SLIP[:3], abs=0.01)


def test_one_outlier_that_is_heard_again_and_again_is_one():
    found = heard(lambda k: np.zeros(4), count=50)
    for _ in range(10):
        found = found.taken(50 * PERIOD, wound(50) + SLIP, ROBOT, JUMP, 0.0)
    assert found.rejected == 1 and not found.slid.any()


def test_encoders_of_winches_that_rest_may_slip_one_alone_that_stood_still_came_free():
    still = wound(0)
    all_rest = LengthReadings.first(0.0, still, TOLERANCES)
    one_stuck = LengthReadings.first(0.0, still, TOLERANCES)
    for k in range(1, 60):
        moved = still + SLIP * (k >= 30)
        all_rest = all_rest.taken(k * PERIOD, moved, ROBOT, JUMP, 0.0)
        stuck = wound(k)
        stuck[0] = still[0] + 0.3 * (k >= 30)
        one_stuck = one_stuck.taken(k * PERIOD, stuck, ROBOT, JUMP, 0.0)
    assert all_rest.slid == pytest.approx(SLIP, abs=1e-9)
    assert not one_stuck.slid.any()


def test_rare_readings_are_joined_by_what_a_winch_can_do():
    """Constant acceleration between readings 0.25 s apart is followed, in short segments."""
    moves = np.array([0.5, -0.4, 0.3, 0.1])

    def true(time: float) -> np.ndarray:
        return 6.0 + moves * (0.4 * time - 0.5 * time**2)

    found = LengthReadings.first(0.0, true(0.0), TOLERANCES)
    for k in range(1, 5):
        found = found.taken(0.25 * k, true(0.25 * k), ROBOT, JUMP, 0.0)
    ends = found.knots(0.5, 1.0, 0.02)
    assert ends[-1] == 1.0 and np.diff([0.5, *ends]).max() <= TOLERANCES.segment + 1e-9
    for time in ends:
        assert found.at(time) == pytest.approx(true(time), abs=1e-9)


def test_readings_that_drop_out_leave_a_still_cable_straight():
    """The slope between two readings in quick succession is noise, and no part of a long gap."""
    noise = np.random.default_rng(0).normal(scale=1e-4, size=(40, 4))
    times = [*(0.002 * np.arange(20)), 0.338, *(0.338 + 0.002 * np.arange(1, 10))]
    found = LengthReadings.first(0.0, 6.0 + noise[0], TOLERANCES)
    for time, error in zip(times[1:22], noise[1:22], strict=True):
        found = found.taken(time, 6.0 + error, ROBOT, JUMP, 0.0)
    for time in (0.1, 0.2, 0.3):
        assert found.at(time) == pytest.approx(np.full(4, 6.0), abs=5e-4)
