"""Intervals that cover, tests that hold their level, and both see what is there."""

import numpy as np
import pytest

from carosac_toolkit.studies.compare.resampling import (
    BOOTSTRAP_RESAMPLES,
    INTERVAL_SEEDS_MIN,
    holm,
    interval,
    sign_flip_p,
    smallest_p,
    typical,
)


def drawn(rng, seeds, paths, shared):
    """Normal draws about zero, of which a share of the variance is common to a seed."""
    common = rng.normal(size=(seeds, 1)) * np.sqrt(shared)
    return common + rng.normal(size=(seeds, paths)) * np.sqrt(1.0 - shared)


def test_typical_is_the_median_over_seeds_then_the_mean_over_paths():
    table = np.array([[1.0, 10.0], [2.0, np.nan], [30.0, 20.0]])
    assert typical(table[None]) == pytest.approx([0.5 * (2.0 + 15.0)])
    empty = np.array([[[1.0, np.nan], [3.0, np.nan]], [[np.nan, np.nan], [np.nan, np.nan]]])
    assert typical(empty)[0] == 2.0 and np.isnan(typical(empty)[1])


@pytest.mark.parametrize("seeds", [6, 10])
@pytest.mark.parametrize("shared", [0.1, 0.7])
def test_intervals_cover_the_truth_about_as_often_as_they_say(seeds, shared):
    rng = np.random.default_rng(7)
    hits = 0
    for k in range(250):
        low, high = interval(typical, drawn(rng, seeds, 3, shared), resamples=800, seed=k)
        hits += low <= 0.0 <= high
    # 95 % nominal; three binomial deviations of 250 runs are 4 %; ours are a little too wide
    assert 0.91 <= hits / 250 <= 1.0


def test_cases_of_a_seed_are_not_taken_for_independent():
    rng = np.random.default_rng(3)
    table = np.repeat(rng.normal(size=(8, 1)), 5, axis=1)
    of_seeds = interval(typical, table[:, :1])
    assert interval(typical, table) == pytest.approx(of_seeds)  # five copies say nothing new
    low, high = interval(typical, table.reshape(40, 1))  # as if all 40 were independent
    assert high - low < 0.75 * (of_seeds[1] - of_seeds[0])


def test_paired_intervals_are_shorter_than_those_of_the_same_data_unpaired():
    rng = np.random.default_rng(1)
    plant = 50.0 * rng.normal(size=(10, 4))  # what both meet
    one, other = plant + rng.normal(size=(10, 4)), plant + 3.0 + rng.normal(size=(10, 4))
    paired = interval(typical, other - one)
    mixed = interval(typical, other[rng.permutation(10)] - one)
    assert paired[0] > 0.0 and mixed[0] < 0.0
    assert paired[1] - paired[0] < 0.1 * (mixed[1] - mixed[0])


def test_an_interval_needs_some_seeds_and_a_value_in_each_resample():
    table = np.arange(18.0).reshape(6, 3)
    assert interval(typical, table[: INTERVAL_SEEDS_MIN - 1]) is None
    assert interval(typical, table[:INTERVAL_SEEDS_MIN]) is not None
    table[:2] = np.nan
    assert interval(typical, table) is None  # four seeds are left


def test_a_path_that_most_seeds_lack_does_not_slip_out_of_the_interval():
    """Without the hard path it would be an interval of the two easy ones, at 50."""
    rng = np.random.default_rng(4)
    table = np.column_stack([rng.normal([50.0, 50.0], 5.0, (20, 2)), np.full(20, np.nan)])
    table[: INTERVAL_SEEDS_MIN - 1, 2] = 300.0
    assert interval(typical, table) is None  # four seeds tell nothing of the hard path
    table[INTERVAL_SEEDS_MIN - 1, 2] = 300.0
    low, high = interval(typical, table)
    assert 125.0 < low < high < 142.0
    assert interval(typical, table[:, :2])[1] < 60.0


def test_an_interval_is_the_same_again_and_its_end_scales_with_the_unit():
    table = np.random.default_rng(0).normal(size=(7, 3))
    first = interval(typical, table)
    assert interval(typical, table) == first
    assert interval(typical, 1e3 * table) == pytest.approx(tuple(1e3 * x for x in first))
    low, high = interval(typical, -table)
    assert (low, high) == pytest.approx((-first[1], -first[0]), abs=0.2)


def test_the_sign_test_is_exact():
    assert sign_flip_p(np.ones((6, 4))) == pytest.approx(2 / 2**6) == smallest_p(6)
    assert sign_flip_p(-np.ones((6, 4))) == pytest.approx(2 / 2**6)
    assert sign_flip_p(np.zeros((6, 4))) == 1.0
    assert sign_flip_p(np.full((6, 4), np.nan)) is None
    # 3 seeds won by 2, 1 and 1, one lost by 1: 6 of 16 exchanges are as far out as their sum, 3
    outcomes = np.array([[1.0, 1.0], [1.0, 0.0], [1.0, np.nan], [-1.0, 0.0]])
    assert sign_flip_p(outcomes) == pytest.approx(sum(
        abs(2 * a + b + c + d) >= 3
        for a in (-1, 1) for b in (-1, 1) for c in (-1, 1) for d in (-1, 1)
    ) / 16)  # fmt: skip


@pytest.mark.parametrize("seeds", [8, 20])
def test_the_sign_test_keeps_its_level(seeds):
    rng = np.random.default_rng(11)
    found = [
        sign_flip_p(np.sign(drawn(rng, seeds, 3, 0.5)), draws=400, seed=k) <= 0.05
        for k in range(400)
    ]
    assert np.mean(found) < 0.05 + 3 * np.sqrt(0.05 * 0.95 / 400)


def test_holm_against_a_textbook_case_and_with_gaps():
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm([None, 0.02, 0.9, None]) == [None, 0.04, 0.9, None]
    assert holm([0.6, 0.7]) == [1.0, 1.0]
    assert smallest_p(40) == pytest.approx(1 / (BOOTSTRAP_RESAMPLES + 1))
