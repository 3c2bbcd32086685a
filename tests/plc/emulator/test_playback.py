import numpy as np
import pytest

from carosac_toolkit.plc.emulator.playback import Playback

PERIOD, CYCLE = 0.01, 0.002


def played(lengths, jitter=None):
    """Positions and rates at each PLC cycle while commands come every period or so."""
    playback = Playback(lengths[0])
    rng = np.random.default_rng(3)
    found, due, k = [], 0.0, 0
    for i in range(round(len(lengths) * PERIOD / CYCLE)):
        while k < len(lengths) and i * CYCLE >= due - 1e-9:
            playback.add(lengths[k], 1, PERIOD)
            k += 1
            due = k * PERIOD + (0.0 if jitter is None else rng.uniform(0.0, jitter))
        found.append(playback.advance(CYCLE))
    return np.array([p for p, _ in found])[:, 0], np.array([v for _, v in found])[:, 0]


def wave():
    t = np.arange(200) * PERIOD
    return (9.0 + 0.2 * np.sin(2 * np.pi * t))[:, None]


def test_rate_is_the_derivative_of_position():
    position, rate = played(wave())
    numeric = (position[2:] - position[:-2]) / (2 * CYCLE)
    # Where commands come, the motion is steered a little: 1e-2 of the largest speed, 1.26 m/s.
    assert rate[101:-1] == pytest.approx(numeric[100:], abs=0.013)


@pytest.mark.parametrize("jitter", [None, 0.004])
def test_acceleration_stays_that_of_the_commands(jitter):
    commands = wave()
    _, rate = played(commands, jitter)
    asked = np.abs(np.diff(commands[:, 0], 2)).max() / PERIOD**2
    got = np.abs(np.diff(rate[200:]) / CYCLE).max()
    assert got < asked * 1.3  # steering moves the clock by a few percent


def test_a_straight_line_stays_one_and_is_late_by_the_time_that_is_stated():
    t = np.arange(200) * PERIOD
    position, rate = played((9.0 + 0.5 * t)[:, None])
    now = (np.arange(len(position)) + 1) * CYCLE
    late = now - (position - 9.0) / 0.5
    assert rate[-50:] == pytest.approx(np.full(50, 0.5))
    assert 0.75 * PERIOD <= late[-50:].min() and late[-50:].max() <= 1.85 * PERIOD


def test_without_commands_it_goes_on_straight_for_a_period_or_two_and_ends():
    playback = Playback(np.array([9.0]))
    for k in range(100):
        playback.add(np.array([9.0 + 0.005 * k]), 1, PERIOD)
        playback.advance(PERIOD)
    goals = []
    while not playback.ended:
        goals.append(playback.advance(CYCLE))
    last = 9.0 + 0.005 * 99
    assert last + 1.5 * 0.005 == pytest.approx(goals[-1][0][0], abs=0.5 * CYCLE)
    assert [rate[0] for _, rate in goals] == pytest.approx([0.5] * len(goals))
    playback.add(np.array([last + 0.005]), 1, PERIOD)
    assert not playback.ended


def test_lost_commands_lie_on_a_straight_line():
    playback = Playback(np.array([9.0]))
    for k in range(1, 60):
        playback.add(np.array([9.0 + 0.005 * 3 * k]), 3, PERIOD)
        rates = [playback.advance(CYCLE)[1][0] for _ in range(15)]
    assert rates == pytest.approx([0.5] * 15)
