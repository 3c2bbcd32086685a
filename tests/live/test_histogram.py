import tracemalloc

import numpy as np
import pytest

from carosac_toolkit.live.histogram import Histogram


@pytest.mark.parametrize("share", [0.01, 0.5, 0.9, 0.99, 0.999])
def test_quantiles_are_within_half_a_percent_of_those_of_all_times(share):
    times = np.random.default_rng(0).lognormal(mean=-7.0, sigma=1.0, size=20_000)
    histogram = Histogram()
    for time in times:
        histogram.add(time)
    wanted = np.quantile(times, share, method="inverted_cdf")
    assert histogram.quantile(share) == pytest.approx(wanted, rel=0.006)
    assert histogram.largest == times.max()


def test_nothing_zero_and_far_too_long_are_told():
    histogram = Histogram()
    assert histogram.quantile(0.5) is None
    histogram.add(0.0)
    assert histogram.quantile(0.5) == pytest.approx(0.0, abs=1e-6)
    for _ in range(3):
        histogram.add(1e6)
    assert histogram.quantile(0.9) == pytest.approx(1e3, rel=0.02)
    assert histogram.largest == 1e6


def test_a_long_run_takes_no_more_memory_than_a_short_one():
    histogram = Histogram()
    histogram.add(1e-3)
    tracemalloc.start()
    for k in range(50_000):
        histogram.add(1e-4 * (1 + k % 97))
    grown = tracemalloc.get_traced_memory()[0]
    tracemalloc.stop()
    assert grown < 2_000
