from __future__ import annotations

import numpy as np
import pytest

from calibration.observability import NAMED_COMBINATIONS_MAX, NAMED_PARAMETERS_MAX, judge

NAMES = ("exit_points[a].x", "length_offset[a]", "mass")
SCALE = np.array([0.05, 1.0, 2.0])


def information(rows, sigma):
    rows = np.asarray(rows, dtype=float)
    return rows.T @ rows / sigma**2


def test_data_that_see_everything_leave_nothing_to_say():
    found = judge(NAMES, information(np.eye(3), 1e-3), SCALE)
    assert found.rank == found.parameters == 3
    assert found.condition == pytest.approx(2.0 / 0.05)  # of the Jacobian in units of the scale
    assert found.blind == found.weak == ()
    assert found.sentences() == [
        "the data say something of 3 of 3 combinations of the parameters, and more than was known "
        "before of 3, condition 40"
    ]


def test_a_sum_that_is_all_the_data_see_leaves_the_difference_blind():
    """Radial exit error against offset: only their sum changes a reading."""
    rows = [[1.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
    found = judge(NAMES, information(rows, 1e-3), np.ones(3))
    assert found.rank == 2 and found.condition == np.inf
    assert set(found.blind) <= {
        "exit_points[a].x - length_offset[a]", "length_offset[a] - exit_points[a].x",
    }  # fmt: skip
    assert len(found.blind) == 1 and found.weak == ()
    first, second = found.sentences()
    assert first == (
        "the data say something of 2 of 3 combinations of the parameters, and more than was known "
        "before of 2"
    )
    assert second == f"the data say nothing about {found.blind[0]}"


def test_what_the_data_say_less_of_than_the_prior_is_weak():
    rows = np.diag([1.0 / 0.05, 1.0 / 1.0, 1.0 / 2.0]) * np.array([1e3, 1e3, 0.9])
    found = judge(NAMES, information(rows, 1.0), SCALE)
    assert found.weak == ("mass",) and found.blind == () and found.rank == 3
    assert judge(NAMES, information(rows * [1.0, 1.0, 1.2], 1.0), SCALE).weak == ()


def test_the_words_do_not_depend_on_units():
    """Millimetres or metres: the same sentences, as scale and information change together."""
    rows = np.array([[1.0, 0.5, 0.1], [0.2, 1e-9, 1e-9]])
    unit = np.array([1e3, 1e-2, 10.0])
    one = judge(NAMES, information(rows, 1e-3), SCALE)
    other = judge(NAMES, information(rows / unit, 1e-3), SCALE * unit)
    assert other.blind == one.blind and other.weak == one.weak
    assert other.rank == one.rank


def test_without_any_data_everything_is_blind():
    found = judge(NAMES, np.zeros((3, 3)), SCALE)
    assert found.rank == 0 and len(found.blind) == 3


def test_what_is_well_known_is_not_blind_beside_what_is_known_far_better():
    """A sigma of a tenth of the prior is knowledge, however much more is known of the rest."""
    rows = np.diag([1e6, 10.0, 1e6])
    found = judge(NAMES, information(rows, 1.0), np.ones(3))
    assert found.blind == found.weak == () and found.rank == 3


def test_rounding_does_not_pass_for_knowledge():
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    rows = 1e9 * turn[:2]
    assert len(judge(NAMES, information(rows, 1.0), np.ones(3)).blind) == 1


def test_few_combinations_of_few_parameters_are_named():
    names = [f"exit_points[{i}].x" for i in range(20)]
    rows = np.vstack([np.ones(20), np.eye(20)[1:10]])
    found = judge(names, information(rows, 1e-3), np.ones(20))
    assert found.rank == 10 and len(found.blind) == 10
    said = [line for line in found.sentences() if "nothing" in line]
    assert len(said) == NAMED_COMBINATIONS_MAX and said[-1].endswith(
        "; and 4 more such combinations"
    )
    assert all(line.count("exit_points") <= NAMED_PARAMETERS_MAX for line in said)
    assert any(
        "more" in line for line in said[:-1] if line.count("exit_points") == NAMED_PARAMETERS_MAX
    )


def test_json_names_all():
    found = judge(NAMES, information([[1.0, 1.0, 0.0]], 1e-3), np.ones(3))
    assert found.data() == {
        "parameters": 3, "rank": 1, "condition": np.inf, "blind": list(found.blind), "weak": [],
    }  # fmt: skip
