from __future__ import annotations

import itertools

import numpy as np
import pytest

from calibration.guide.simulated import taped_distance
from tests.calibration.guide.scenes import ROBOT


def test_each_reading_of_a_tape_has_its_own_error():
    errors = []
    for first, second in itertools.combinations(ROBOT.cable_names, 2):
        one = taped_distance(ROBOT, first, second, seed=0)
        ends = [ROBOT.exit_points[ROBOT.cable_names.index(name)] for name in (first, second)]
        errors.append(one.length - float(np.linalg.norm(ends[0] - ends[1])))
        assert taped_distance(ROBOT, second, first, seed=0).length == pytest.approx(one.length)
    assert np.ptp(errors) > 5e-4
    assert np.abs(errors).max() < 5e-3
