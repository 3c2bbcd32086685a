"""Paired comparisons of rows: signs, failures, gaps."""

import numpy as np
import pytest

from carosac_toolkit.studies.compare.pairs import IntervalEstimate, compare, typical_of

COLUMN = "tracking_rmse_norm_m"


def rows_of(table, *, failed=(), column=COLUMN):
    """Rows of a table (S, T) of errors; `failed` are its indices without a score."""
    rows = []
    for (seed, path), value in np.ndenumerate(np.asarray(table, dtype=float)):
        status = "failed" if (seed, path) in failed else "ok"
        known = None if status == "failed" or np.isnan(value) else float(value)
        rows.append({"seed": seed, "trajectory": f"p{path}", "status": status, column: known})
    return rows


@pytest.fixture
def pair():
    rng = np.random.default_rng(5)
    plant = rng.uniform(0.02, 0.2, size=(8, 3))
    return 0.6 * plant, plant * rng.uniform(0.9, 1.1, size=(8, 3))


def test_swapped_order_flips_the_sign_and_inverts_the_ratio(pair):
    one, other = (rows_of(table) for table in pair)
    there, back = compare(one, other, COLUMN), compare(other, one, COLUMN)
    assert there.difference.value == pytest.approx(-back.difference.value)
    assert there.difference.value < 0.0 and there.difference.excludes(0.0)
    assert there.ratio.value == pytest.approx(1.0 / back.ratio.value) == pytest.approx(0.6, abs=0.1)
    assert (there.won, there.lost) == (back.lost, back.won) == (24, 0)
    assert there.p == back.p == pytest.approx(2 / 2**8)
    assert there.typical == back.typical[::-1]


def test_rows_in_another_order_are_the_same_comparison(pair):
    one, other = (rows_of(table) for table in pair)
    assert compare(one[::-1], other, COLUMN).won == 24
    mixed = np.random.default_rng(0).permutation(len(other))
    shuffled = compare(one, [other[k] for k in mixed], COLUMN)
    assert shuffled.difference.value == pytest.approx(compare(one, other, COLUMN).difference.value)


def test_who_fails_loses_the_case_and_the_error_is_over_the_others(pair):
    lost = {(0, 0), (0, 1), (3, 2)}
    both = {(5, 0)}
    one = rows_of(pair[0], failed=lost | both)
    other = rows_of(pair[1], failed=both | {(6, 1)})
    found = compare(one, other, COLUMN)
    assert (found.cases, found.scored, found.failed) == (24, 19, (4, 2))
    assert (found.won, found.lost) == (20, 3)  # of 23; nobody has won where both failed
    swapped = compare(other, one, COLUMN)
    assert (swapped.won, swapped.lost, swapped.failed) == (3, 20, (2, 4))
    mask = np.ones((8, 3), dtype=bool)
    for k in lost | both | {(6, 1)}:
        mask[k] = False
    wanted = np.nanmedian(np.where(mask, pair[0] - pair[1], np.nan), axis=0).mean()
    assert found.difference.value == pytest.approx(wanted)


def test_a_controller_that_always_fails_has_lost_all_and_no_difference(pair):
    everywhere = set(np.ndindex(8, 3))
    found = compare(rows_of(pair[0], failed=everywhere), rows_of(pair[1]), COLUMN)
    assert (found.won, found.lost, found.scored) == (0, 24, 0)
    assert found.difference is found.ratio is found.typical is None
    assert found.p == pytest.approx(2 / 2**8)
    assert found.data()["difference"] is None and found.data()["failures"] == 24


def test_cases_in_which_the_error_means_nothing_are_left_out(pair):
    pair[0][2, 1] = pair[1][2, 1] = np.nan  # this path has no part near the boundary
    found = compare(rows_of(pair[0]), rows_of(pair[1], failed={(2, 1)}), COLUMN)
    assert (found.cases, found.scored, found.failed) == (23, 23, (0, 0))


def test_equal_errors_are_nobodys_case_and_a_perfect_baseline_has_no_ratio(pair):
    same = compare(rows_of(pair[0]), rows_of(pair[0]), COLUMN)
    assert (same.won, same.lost, same.p) == (0, 0, 1.0)
    assert same.difference == IntervalEstimate(value=0.0, low=0.0, high=0.0)
    assert compare(rows_of(pair[0]), rows_of(0.0 * pair[1]), COLUMN).ratio is None


def test_few_seeds_have_no_interval(pair):
    found = typical_of(rows_of(pair[0][:2]), COLUMN)
    assert found.low is found.high is None and not found.excludes(1e9)
    assert typical_of(rows_of(pair[0], failed=set(np.ndindex(8, 3))), COLUMN) is None
