"""Readings as a smooth function of time: noise goes, motion stays."""

import numpy as np
import pytest

from carosac_toolkit.recordings.length_path import LengthPath
from carosac_toolkit.recordings.recording import Recording


def path_of(time, length, noise, seed=0):
    """The path of one cable whose readings are noisy."""
    drawn = length + noise * np.random.default_rng(seed).standard_normal(len(time))
    return LengthPath(Recording(time=time, unstrained_length=drawn[:, None]))


@pytest.mark.parametrize("rate", [4.0, 10.0, 20.0, 100.0])
@pytest.mark.parametrize("frequency", [0.3, 0.5])
def test_a_swinging_winch_is_followed_at_every_rate(rate, frequency):
    """Cross-validation alone smooths some of these motions away."""
    time = np.arange(0.0, 60.0, 1.0 / rate)
    length = 6.0 + 0.1 * np.sin(2.0 * np.pi * frequency * time) * (time > 5.0)
    found = path_of(time, length, 3e-4).at(time)[:, 0]
    assert np.sqrt(((found - length) ** 2).mean()) < 3e-3


def test_a_cable_that_stands_still_is_held_at_its_mean():
    time = np.arange(0.0, 10.0, 0.01)
    found = path_of(time, np.full(len(time), 6.0), 2e-4).at(time)[:, 0]
    assert np.ptp(found) < 1e-12 and found[0] == pytest.approx(6.0, abs=3e-5)


@pytest.mark.parametrize(
    ("length", "rate"),
    [
        (lambda t: 0.05 * np.sin(2.0 * np.pi * t), 4.0),
        (lambda t: 0.05 * (-1.0) ** np.arange(len(t)), 4.0),
        (lambda t: np.random.default_rng(1).uniform(-1.0, 1.0, len(t)), 0.2),
    ],
    ids=["aliased", "to and fro", "poses of a table"],
)
def test_motion_that_looks_white_is_none_the_less_motion(length, rate):
    time = np.arange(0.0, 200.0, 1.0) / rate
    wanted = 6.0 + length(time)
    found = path_of(time, wanted, 1e-4).at(time)[:, 0]
    assert np.sqrt(((found - wanted) ** 2).mean()) < 4e-3
