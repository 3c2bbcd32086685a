import numpy as np
import pytest

from carosac_toolkit.base.errors import InvalidField
from learned.exploration_settings import ExplorationSettings

pytest.importorskip("stable_baselines3")

from learned.exploration import NOISE_REVERSION, DecayingNoise


def drawn(progress, count=400, seed=0):
    noise = DecayingNoise(ExplorationSettings(start=0.2, end=0.01), (200, 4), seed)
    noise.progress = progress
    return np.stack([noise() for _ in range(count)])[50:]  # at rest by then


@pytest.mark.parametrize("progress, sigma", [(0.0, 0.2), (0.5, 0.105), (1.0, 0.01), (1.1, 0.01)])
def test_the_standard_deviation_falls_linearly_to_its_end(progress, sigma):
    assert np.std(drawn(progress)) == pytest.approx(sigma, rel=0.02)


def test_noise_remembers_what_the_process_of_ornstein_and_uhlenbeck_remembers():
    values = drawn(0.0)
    for lag in (1, 5):
        found = np.mean(values[lag:] * values[:-lag]) / np.mean(values**2)
        assert found == pytest.approx((1.0 - NOISE_REVERSION) ** lag, abs=0.02)
    rows = values[:, :, 0]
    assert abs(np.mean(rows[:, :-1] * rows[:, 1:])) < 0.02 * 0.04  # environments on their own


def test_where_an_episode_has_ended_noise_starts_at_zero():
    settings = ExplorationSettings(start=0.2, end=0.2)
    noise = DecayingNoise(settings, (3, 2), 0)
    for _ in range(10):
        before = noise()
    state = noise.state()
    noise.reset([1])
    after = noise()
    noise.restore(state)
    without = noise()
    np.testing.assert_array_equal(after[[0, 2]], without[[0, 2]])
    np.testing.assert_allclose(without[1] - after[1], (1 - NOISE_REVERSION) * before[1], rtol=1e-5)
    noise.reset()
    assert np.abs(noise.state()["value"]).max() == 0.0


def test_restored_noise_goes_on_bit_by_bit_at_its_progress():
    noise = DecayingNoise(ExplorationSettings(), (3, 2), 0)
    noise.progress = 0.7
    noise()
    state = noise.state()
    expected = [noise() for _ in range(5)]
    other = DecayingNoise(ExplorationSettings(), (3, 2), 5)
    other.restore(state)
    np.testing.assert_array_equal([other() for _ in range(5)], expected)


@pytest.mark.parametrize("start, end", [(0.1, 0.2), (0.1, -0.1), (float("inf"), 0.1)])
def test_noise_that_grows_is_refused(start, end):
    with pytest.raises(InvalidField, match=r"exploration: got .*; allowed: start >= end >= 0"):
        ExplorationSettings(start=start, end=end)
