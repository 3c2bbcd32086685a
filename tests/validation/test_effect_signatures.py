"""Signatures of effects at the samples of a run."""

import numpy as np
import pytest

import carosac_toolkit as ct
from carosac_toolkit.validation.effect_signatures import _filled, _variants


@pytest.mark.parametrize("first", [0.0, 0.01, 17.23, 1.7e9])
@pytest.mark.parametrize("step", [0.05, 0.1, 0.25])
def test_times_that_fill_gaps_keep_all_samples(first, step):
    for count in range(150, 1500, 111):
        time = np.array([round(first + 0.1 * k, 6) for k in range(count)])
        when, rows = _filled(time, step)
        np.testing.assert_array_equal(when[rows], time)
        assert (np.diff(when) > 0.01).all() and np.diff(when).max() < 1.01 * max(step, 0.05)


def test_a_tilt_turns_the_pulleys_with_their_exit_points():
    robot = ct.load_robot("carosac")
    tilted = (
        each for each in _variants(robot, np.full((3, 4), 5.0), None) if each.effect == "tilt"
    )
    for _ in range(2):
        one = next(tilted)
        assert np.abs(one.robot.exit_points - robot.exit_points).max() > 1e-3
        for name in ("exit_points", "swivel_axis"):
            back = getattr(one.robot, name) @ one.back.T
            np.testing.assert_allclose(back, getattr(robot, name), atol=1e-12)
