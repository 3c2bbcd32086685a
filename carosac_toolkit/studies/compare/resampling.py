"""Intervals and tests by resampling, where only seeds are independent of each other.

The cases of one seed share the plant and the biases of the sensors, so a study with S seeds and T
trajectories has S independent draws, not S x T. All tables here have one row per seed, and whole
rows are drawn or change their sign: a cluster bootstrap and a cluster permutation test.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from carosac_toolkit.base.arrays import Array

CONFIDENCE_LEVEL = 0.95
BOOTSTRAP_RESAMPLES = 5000
INTERVAL_SEEDS_MIN = 5  # seeds from which an interval is given
EXACT_TEST_SEEDS_MAX = 14  # seeds up to which all sign changes are tried
SORTED_VALUES_MAX = 2_000_000  # numbers that are sorted at once
ROUNDING_TOLERANCE = 1e-9  # share of the largest sum by which equal sums may differ

Statistic = Callable[..., Array]  # tables (R, S, T), one for each given, to values (R,)


def typical(table: Array) -> Array:
    """Return the median over the seeds of each trajectory, then the mean over the trajectories.

    Trajectories differ in how hard they are, so that errors of all of them together have several
    modes, between which a median of all would jump; over the seeds of one it is robust.

    Args:
        table: Shape (R, S, T), NaN where there is no case.

    Returns:
        Shape (R,); trajectories without any case are left out, NaN where there is none at all.
    """
    ordered = np.sort(table, axis=1)  # NaN last
    count = (~np.isnan(ordered)).sum(axis=1, keepdims=True)
    low = np.take_along_axis(ordered, np.maximum(count - 1, 0) // 2, axis=1)
    high = np.take_along_axis(ordered, np.minimum(count // 2, table.shape[1] - 1), axis=1)
    middle, some = (0.5 * (low + high))[:, 0], (count > 0)[:, 0]
    total = np.where(some, middle, 0.0).sum(axis=1)
    paths = some.sum(axis=1)
    return np.where(paths > 0, total / np.maximum(paths, 1), np.nan)


def interval(
    statistic: Statistic,
    *tables: Array,
    confidence: float = CONFIDENCE_LEVEL,
    resamples: int = BOOTSTRAP_RESAMPLES,
    seed: int = 0,
) -> tuple[float, float] | None:
    """Return the confidence interval of a statistic: cluster bootstrap, expanded percentiles.

    Seeds are drawn with replacement, each with all its cases and in all tables alike. Percentile
    intervals of few clusters are too short: their variance lacks a factor S / (S - 1), and the
    normal distribution stands for Student's. Both are put right by the percentiles that are taken,
    with tails Phi(-sqrt(S / (S - 1)) t) where t is the quantile of Student's distribution with
    S - 1 degrees of freedom.

    Args:
        statistic: Called with one table of shape (R, S, T) for each of `tables`.
        tables: Shape (S, T), NaN where there is no case; one row per seed.
        confidence: Confidence level of the interval.
        resamples: Number of resamples.
        seed: Seed of the resampling.

    Returns:
        Lower and upper end; None with fewer than `INTERVAL_SEEDS_MIN` seeds, in all or on a
        trajectory that has any, or where a resample has no value. Resamples without a trajectory
        are left out, as they would estimate something else.

    References:
        Davison and Hinkley, *Bootstrap Methods and their Application*, 1997, section 3.8.
        Hesterberg, What Teachers Should Know About the Bootstrap, *The American Statistician* 69
        (4), 2015, section 5.3.
    """
    known = np.any([~np.isnan(table) for table in tables], axis=(0, 2))
    kept = [table[known] for table in tables]
    seeds = len(kept[0])
    found_on = np.array([(~np.isnan(table)).sum(axis=0) for table in kept])
    if seeds < INTERVAL_SEEDS_MIN or (found_on[found_on > 0] < INTERVAL_SEEDS_MIN).any():
        return None
    rng = np.random.default_rng(seed)
    step = max(1, SORTED_VALUES_MAX // kept[0].size)
    values = []
    for first in range(0, resamples, step):
        drawn = rng.integers(0, seeds, size=(min(step, resamples - first), seeds))
        for table in kept:
            drawn = drawn[_with_all_paths(table, drawn)]
        values.append(statistic(*(table[drawn] for table in kept)))
    samples = np.concatenate(values)
    if np.isnan(samples).any():
        return None
    tail = _tail(confidence, seeds)
    low = np.quantile(samples, tail, method="lower")
    return float(low), float(np.quantile(samples, 1.0 - tail, method="higher"))


def _with_all_paths(table: Array, drawn: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return the draws of rows (R, S) that have a case on every trajectory with any, (R,)."""
    there = ~np.isnan(table)
    gaps = there[:, there.any(axis=0) & ~there.all(axis=0)]
    on_each: NDArray[np.bool_] = np.asarray(gaps[drawn].any(axis=1))
    return np.asarray(on_each.all(axis=1))


def sign_flip_p(
    outcomes: Array, *, draws: int = BOOTSTRAP_RESAMPLES, seed: int = 0
) -> float | None:
    """Return the two-sided p of the net number of cases won: a paired permutation test over seeds.

    Under the null hypothesis that the two are equal, the labels of all cases of a seed may be
    exchanged. With S seeds no p is below 2 / 2^S. Up to `EXACT_TEST_SEEDS_MAX` seeds all
    exchanges are tried and the test is exact. It is a sign test for clusters: like the median, it
    ignores by how much a case is won, so that a few large errors decide nothing.

    Args:
        outcomes: 1, 0 or -1 for a case that the first of the two won, that nobody won, or that it
            lost, shape (S, T), one row per seed; NaN where there is no case.
        draws: Random exchanges with more seeds than `EXACT_TEST_SEEDS_MAX`.
        seed: Seed of these exchanges.

    Returns:
        p, or None without a case.

    References:
        Good, *Permutation, Parametric and Bootstrap Tests of Hypotheses*, 2005, section 3.
    """
    known = ~np.isnan(outcomes)
    if not known.any():
        return None
    return _flipped(np.nansum(outcomes[known.any(axis=1)], axis=1), draws, seed)


def holm(p_values: Sequence[float | None]) -> list[float | None]:
    """Adjust each p for their number (Holm), which bounds the chance of any false finding.

    References:
        Holm, A Simple Sequentially Rejective Multiple Test Procedure, *Scandinavian Journal of
        Statistics* 6, 1979.
    """
    known = sorted((p, k) for k, p in enumerate(p_values) if p is not None)
    adjusted: list[float | None] = [None] * len(p_values)
    largest = 0.0
    for place, (p, k) in enumerate(known):
        largest = max(largest, min(1.0, (len(known) - place) * p))
        adjusted[k] = largest
    return adjusted


def smallest_p(seeds: int) -> float:
    """Return the smallest p that this many seeds can give."""
    return (
        float(min(1.0, 2.0 ** (1 - seeds)))
        if seeds <= EXACT_TEST_SEEDS_MAX
        else 1.0 / (BOOTSTRAP_RESAMPLES + 1)
    )


def _flipped(sums: Array, draws: int, seed: int) -> float:
    """Return the share of sign changes whose total is as far from zero as that of the sums (S,)."""
    seeds = len(sums)
    if seeds <= EXACT_TEST_SEEDS_MAX:
        bits = np.arange(2**seeds)[:, None] >> np.arange(seeds) & 1
    else:
        bits = np.random.default_rng(seed).integers(0, 2, size=(draws, seeds))
    totals = np.abs((1.0 - 2.0 * bits) @ sums)
    far = totals >= abs(sums.sum()) - ROUNDING_TOLERANCE * float(np.abs(sums).sum())
    return (
        float(far.mean()) if seeds <= EXACT_TEST_SEEDS_MAX else float((1 + far.sum()) / (1 + draws))
    )


def _tail(confidence: float, seeds: int) -> float:
    """Return the percentile of the lower end."""
    from scipy.special import ndtr, stdtrit

    quantile = float(stdtrit(seeds - 1, 0.5 + 0.5 * confidence))
    return float(ndtr(-np.sqrt(seeds / (seeds - 1)) * quantile))
