"""Rows that are chosen evenly: never too many, none twice, both ends among them."""

import numpy as np
import pytest

from carosac_toolkit.base.arrays import evenly


@pytest.mark.parametrize("count", [1, 2, 9, 10, 11, 19, 400])
def test_rows_are_few_and_evenly_spread(count):
    found = evenly(count, 10)
    assert len(found) == min(count, 10)
    assert found[0] == 0 and found[-1] == count - 1
    steps = np.diff(found)
    assert (steps > 0).all() and (len(steps) == 0 or np.ptp(steps) <= 1)
