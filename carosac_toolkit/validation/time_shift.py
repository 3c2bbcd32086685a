"""Shift in time between two clocks, from quantities that one predicts of the other.

The shift with the least squares of measured minus predicted values is searched on a grid, as the
peak of a cross-correlation, then refined by least squares. Constants, and scales where they are
unknown, are fitted for each shift (variable projection: Golub and Pereyra, Inverse Problems 19,
2003). Errors last for many samples, so the sigma comes from sums of the score over blocks of time.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.optimize import minimize_scalar

from carosac_toolkit.base.arrays import Array, evenly
from carosac_toolkit.base.errors import CarosacError

SHIFT_MAX_S = 10.0  # [s]: clocks of one recording are hardly farther apart
SHIFT_STEP_S = 0.04  # [s] of the grid on which a shift is searched
OVERLAP_SHARE_MIN = 0.4  # of the samples of a channel that must have a prediction
SAMPLES_MAX = 2000  # compared, evenly spread
COARSE_SAMPLES_MAX = 500  # compared on the grid
PREDICTION_GAP_S = 0.5  # [s]: across a longer one nothing is predicted
BLOCK_S = 2.5  # [s] after which errors count as independent
BLOCKS_MIN = 4  # of which a sigma is estimated
RIVAL_EVIDENCE_MIN = 10.0  # logarithm of the likelihood ratio of the best shift and its rival
EXPLAINED_SHARE_MIN = 0.3  # of the variance: a prediction that explains less shows no shift
SHIFT_SIGMA_MAX_S = 0.1  # [s]: a shift that is known no better is of no use
COST_MAX = 1e6  # of a shift at which too few samples overlap
SLOW_SHARE = 0.3  # of the samples, the slowest, that show the noise of the sensor alone
SECOND_DIFFERENCE_VARIANCE = 1.5  # of white noise, less the mean of its two neighbours
FITTED_NUMBERS = {"none": 1, "each": 2, "mixed": 4}  # per value: a constant, and its scales
Scaling = Literal["none", "each", "mixed"]


class UnknownShift(CarosacError):
    """The signals do not tell how far their clocks are apart."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Signal:
    """Samples with their time stamps.

    Attributes:
        time: Strictly increasing [s], shape (K,).
        value: shape (K, q).
    """

    time: Array
    value: Array


def binned(signal: Signal, width: float) -> Signal:
    """Return the means of stamps and values over bins of time [s] that hold samples."""
    starts = np.flatnonzero(np.diff((signal.time - signal.time[0]) // width, prepend=-1.0))
    counts = np.diff(np.append(starts, len(signal.time)))
    return Signal(
        time=np.add.reduceat(signal.time, starts) / counts,
        value=np.add.reduceat(signal.value, starts, axis=0) / counts[:, None],
    )


@dataclass(frozen=True, kw_only=True)
class TimeShift:
    """Shift between two clocks.

    Attributes:
        seconds: By which the stamps of the measured signal are later than those of the predicted
            one at the same event [s].
        sigma: Standard deviation of it [s].
        explained: Share of the measured variance that the prediction explains there [1].
        explained_unshifted: The same with the stamps as they are [1].
        jitter: Standard deviation of the stamps from sample to sample [s]; NaN where scales are
            fitted too.
        jitter_sigma: Standard deviation of that [s].
    """

    seconds: float
    sigma: float
    explained: float
    explained_unshifted: float
    jitter: float
    jitter_sigma: float


class _Comparison:
    """Measured values against their prediction at any shift."""

    def __init__(self, measured: Signal, predicted: Signal, scaling: Scaling) -> None:
        self._measured = measured
        self._scaling = scaling
        self._time = predicted.time
        self._spline = CubicSpline(predicted.time, predicted.value)
        spread = measured.value.std(axis=0)
        if scaling == "none":  # all columns are in the same unit
            spread = np.full(len(spread), np.sqrt((spread**2).mean()))
        self._spread = np.where(spread > 0.0, spread, 1.0)

    def errors(self, shift: float) -> tuple[Array, NDArray[np.bool_]]:
        """Return errors over the spread of the values (L, q), and which samples they are (K,)."""
        when = self._measured.time - shift
        right = np.clip(np.searchsorted(self._time, when), 1, len(self._time) - 1)
        near = self._time[right] - self._time[right - 1] <= PREDICTION_GAP_S
        inside = near & (when >= self._time[0]) & (when <= self._time[-1])
        measured, predicted = self._measured.value[inside], self._spline(when[inside])
        if len(measured) < 2:
            return np.zeros((0, len(self._spread))), inside
        measured = measured - measured.mean(axis=0)
        predicted = predicted - predicted.mean(axis=0)
        return (measured - self._scaled(measured, predicted)) / self._spread, inside

    def _scaled(self, measured: Array, predicted: Array) -> Array:
        """Return the prediction with the scales that fit best."""
        if self._scaling == "none":
            return predicted
        if self._scaling == "each":  # a sensor may read too much, but not the other way round
            square = np.maximum((predicted**2).sum(axis=0), np.finfo(np.float64).tiny)
            factor = np.maximum((measured * predicted).sum(axis=0) / square, 0.0)
            return np.asarray(predicted * factor)
        parts = [slice(first, first + 3) for first in range(0, predicted.shape[1], 3)]
        mixed = [_projected(measured[:, part], predicted[:, part]) for part in parts]
        return np.hstack(mixed)

    def cost(self, shift: float) -> float:
        """Return the share of the variance that is not explained where both overlap.

        Corrected for the numbers that are fitted; infinite where too few samples overlap.
        """
        errors, inside = self.errors(shift)
        if inside.mean() < OVERLAP_SHARE_MIN:
            return np.inf
        time, measured = self._measured.time[inside], self._measured.value[inside]
        blocks = (time[-1] - time[0]) / BLOCK_S
        free = blocks - FITTED_NUMBERS[self._scaling]
        variance = float((((measured - measured.mean(axis=0)) / self._spread) ** 2).mean())
        if free <= 0.0 or not variance > 0.0:
            return np.inf
        return float((errors**2).mean() / variance * blocks / free)


def find_shift(measured: Signal, predicted: Signal, *, scaling: Scaling = "none") -> TimeShift:
    """Estimate by how much the stamps of a measured signal are late against a predicted one.

    Args:
        measured: K samples of q values.
        predicted: Samples of the same values at other times.
        scaling: ``none``: each value is predicted up to a constant; ``each``: and up to a positive
            factor; ``mixed``: three values in a row are an unknown combination of the three that
            are predicted, as of a sensor that is mounted in an unknown direction.

    Raises:
        UnknownShift: Nothing moves in both, or several shifts fit as well.
    """
    if len(measured.time) < 2 or len(predicted.time) < 2:
        raise UnknownShift("there are too few samples")
    coarse = _Comparison(_thinned(measured, COARSE_SAMPLES_MAX), predicted, scaling)
    few = _thinned(measured, SAMPLES_MAX)
    comparison = _Comparison(few, predicted, scaling)
    grid = _grid(float(measured.time[0] - predicted.time[0]))
    costs = np.array([coarse.cost(shift) for shift in grid])
    best = int(np.argmin(costs))
    if not np.isfinite(costs[best]):
        raise UnknownShift("too few of its samples were recorded at the same time as lengths")
    if not np.isfinite(costs[max(best - 1, 0) : best + 2]).all() or best in (0, len(grid) - 1):
        raise UnknownShift(f"the best offset lies at the end of the search, {grid[best]:.1f} s")
    search = minimize_scalar(
        lambda shift: min(comparison.cost(shift), COST_MAX),
        bounds=(grid[best - 1], grid[best + 1]), method="bounded", options={"xatol": 1e-6},
    )  # fmt: skip
    shift, cost = float(search.x), float(search.fun)
    explained = 1.0 - cost
    if explained < EXPLAINED_SHARE_MIN:
        raise UnknownShift(f"the lengths explain only {max(explained, 0.0):.0%} of its changes")
    _refuse_rivals(few.time, grid, costs, shift, cost)
    sigma = _sigma(comparison, few.time, shift)
    if not sigma <= SHIFT_SIGMA_MAX_S:
        raise UnknownShift("what moves in both is less than the errors")
    jitter, jitter_sigma = np.nan, np.nan
    if scaling == "none":  # other predictions lack what is fast
        jitter, jitter_sigma = _jitter(_Comparison(measured, predicted, scaling), shift)
    unshifted = float(comparison.cost(0.0))
    return TimeShift(
        seconds=shift, sigma=sigma, explained=explained,
        explained_unshifted=1.0 - min(unshifted, 1.0),
        jitter=jitter, jitter_sigma=jitter_sigma,
    )  # fmt: skip


def _grid(apart: float) -> Array:
    """Return the shifts to try [s]: about 0, and about where both begin if that is far away.

    Of two ranges that do not meet the first ends in a NaN, at which nothing overlaps.
    """
    about_zero = np.arange(-SHIFT_MAX_S, SHIFT_MAX_S + 0.5 * SHIFT_STEP_S, SHIFT_STEP_S)
    if abs(apart) <= SHIFT_MAX_S:
        return about_zero
    if abs(apart) > 2.0 * SHIFT_MAX_S:  # clocks of other days
        return np.concatenate([about_zero, [np.nan], apart + about_zero])
    first, last = min(apart, 0.0) - SHIFT_MAX_S, max(apart, 0.0) + SHIFT_MAX_S
    return np.arange(first, last + 0.5 * SHIFT_STEP_S, SHIFT_STEP_S)


def _thinned(signal: Signal, most: int) -> Signal:
    """Return at most so many samples, evenly spread."""
    some = evenly(len(signal.time), most)
    return Signal(time=signal.time[some], value=signal.value[some])


def _refuse_rivals(time: Array, grid: Array, costs: Array, shift: float, cost: float) -> None:
    """Refuse a shift beside which another one fits as well."""
    inner = np.flatnonzero(
        np.isfinite(costs[1:-1]) & (costs[1:-1] <= costs[:-2]) & (costs[1:-1] <= costs[2:])
    )
    rivals = [k for k in inner + 1 if abs(grid[k] - shift) > 2.0 * SHIFT_STEP_S]
    if not rivals:
        return
    rival = min(rivals, key=lambda k: costs[k])
    blocks = (time[-1] - time[0]) / BLOCK_S
    tiny = np.finfo(np.float64).tiny
    evidence = 0.5 * blocks * np.log(max(costs[rival], tiny) / max(cost, tiny))
    if evidence < RIVAL_EVIDENCE_MIN:
        raise UnknownShift(
            f"offsets of {shift:.2f} and {grid[rival]:.2f} s fit as well: the motion repeats itself"
        )


def _projected(measured: Array, predicted: Array) -> Array:
    """Return the combination of predicted columns that fits measured ones best."""
    return np.asarray(predicted @ np.linalg.lstsq(predicted, measured, rcond=None)[0])


def _slope(comparison: _Comparison, shift: float) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Return errors (L, q), their derivative to the shift [1/s], and which samples (K,)."""
    step = 0.25 * SHIFT_STEP_S
    (before, first), (after, last) = (comparison.errors(shift + s) for s in (-step, step))
    errors, inside = comparison.errors(shift)
    common = inside & first & last
    columns = (
        values[common[rows]] for values, rows in ((errors, inside), (before, first), (after, last))
    )
    here, early, late = columns
    return here, (late - early) / (2.0 * step), common


def _sigma(comparison: _Comparison, time: Array, shift: float) -> float:
    """Return the standard deviation of a shift [s], infinite where too little overlaps."""
    errors, slope, common = _slope(comparison, shift)
    edges = np.flatnonzero(np.diff((time[common] - time[0]) // BLOCK_S, prepend=-1.0))
    information = float((slope**2).sum())
    if len(edges) < BLOCKS_MIN or not information > 0.0:
        return np.inf
    scores = np.add.reduceat((errors * slope).sum(axis=1), edges)
    return float(np.sqrt((scores**2).sum() * len(edges) / (len(edges) - 1))) / information


def _jitter(comparison: _Comparison, shift: float) -> tuple[float, float]:
    """Return the jitter of single stamps [s] and its standard deviation.

    A stamp that is wrong by a time alone among its neighbours makes an error of that times the
    slope. White noise of the sensor makes one along all directions alike: what the errors have
    along the slope, and do not have elsewhere or where the slope is small, is jitter.
    """
    errors, slope, _ = _slope(comparison, shift)
    if len(errors) < 3 * BLOCKS_MIN:
        return np.nan, np.nan
    white = errors[1:-1] - 0.5 * (errors[:-2] + errors[2:])
    steady = slope[1:-1]
    speed = np.linalg.norm(steady, axis=1)
    slow = white[speed <= np.quantile(speed, SLOW_SHARE)]
    noise = slow.T @ slow / len(slow)
    if not np.trace(noise) > 0.0:  # computed values, without errors
        return 0.0, 0.0
    noise += 1e-6 * np.trace(noise) * np.eye(len(noise))
    root = np.linalg.inv(np.linalg.cholesky(noise))  # makes the noise alike in all directions
    white, steady = white @ root.T, steady @ root.T
    size = np.linalg.norm(steady, axis=1)
    along = (white * steady).sum(axis=1) / np.maximum(size, np.finfo(np.float64).tiny)
    squares = along**2 / SECOND_DIFFERENCE_VARIANCE
    fit = partial(_variances, size**2)
    rows = np.arange(len(squares))
    weight = np.ones(len(squares))
    for _ in range(5):  # the variance of a square grows with the square
        jitter, floor = fit(squares, weight)
        expected = np.maximum(jitter * size**2 + floor, 1e-12 * squares.mean() + 1e-300)
        weight = 1.0 / expected**2
    edges = rows[:: max(len(rows) // (4 * BLOCKS_MIN), 1)]
    parts = np.array([
        fit(np.delete(squares, part), np.delete(weight, part), keep=np.delete(rows, part))[0]
        for part in np.split(rows, edges[1:])
    ])  # fmt: skip
    deviation = float(np.sqrt((len(parts) - 1) * ((parts - parts.mean()) ** 2).mean()))
    seconds = float(np.sqrt(jitter))
    clear = jitter > deviation
    return seconds, deviation / (2.0 * seconds) if clear else float(np.sqrt(deviation))


def _variances(
    square: Array, values: Array, weight: Array, *, keep: NDArray[np.intp] | None = None
) -> tuple[float, float]:
    """Fit values = jitter * square + noise, neither negative, by weighted least squares."""
    from scipy.optimize import nnls

    rows = square if keep is None else square[keep]
    scale = float(rows.max()) or 1.0
    root = np.sqrt(weight / weight.max())
    basis = np.column_stack([rows / scale, np.ones(len(rows))]) * root[:, None]
    level = float(np.sqrt((values**2).mean())) or 1.0
    jitter, noise = nnls(basis, root * values / level)[0]
    return float(jitter * level / scale), float(noise * level)
