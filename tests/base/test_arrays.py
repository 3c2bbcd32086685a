"""Rows that are chosen evenly: never too many, none twice, both ends among them."""

import numpy as np
import pytest

from carosac_toolkit.base.arrays import evenly, frozen_array


@pytest.mark.parametrize("count", [1, 2, 9, 10, 11, 19, 400])
def test_rows_are_few_and_evenly_spread(count):
    result = evenly(count, 10)
    assert len(result) == min(count, 10)
    assert result[0] == 0 and result[-1] == count - 1
    steps = np.diff(result)
    assert (steps > 0).all() and (len(steps) == 0 or np.ptp(steps) <= 1)


def test_a_frozen_array_is_copied_only_if_somebody_could_write_to_it():
    mine = np.ones(3)
    kept = frozen_array("x", mine, (3,))
    mine[0] = 2.0
    assert kept[0] == 1.0 and not kept.flags.writeable
    assert frozen_array("x", kept, (3,)) is kept
    view = mine[:]
    view.setflags(write=False)
    assert frozen_array("x", view, (3,)) is not view
