"""Signatures of effects at the samples of a run."""

import numpy as np
import pytest

from carosac_toolkit.validation.effect_signatures import _filled


@pytest.mark.parametrize("first", [0.0, 0.01, 17.23, 1.7e9])
@pytest.mark.parametrize("step", [0.05, 0.1, 0.25])
def test_times_that_fill_gaps_keep_all_samples(first, step):
    for count in range(150, 1500, 111):
        time = np.array([round(first + 0.1 * k, 6) for k in range(count)])
        when, rows = _filled(time, step)
        np.testing.assert_array_equal(when[rows], time)
        assert (np.diff(when) > 0.01).all() and np.diff(when).max() < 1.01 * max(step, 0.05)
