"""Physical effects that the error of a simulation looks like, each with its share.

The error is regressed on the signatures of the effects (`effect_signatures`), with priors on their
sizes. What an effect explains is judged on stretches of the run that the regression did not see, or
on others of several runs.
Signatures resemble each other, so shares depend on an order: first comes the effect that explains
most alone, then the one that adds most to it, and so on. What two effects could both explain thus
counts for the one that explains more. Jitter of the stamps and noise of the sensors are white, and
have a share by their variance.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from carosac_toolkit.base.arrays import Array, evenly
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.scaled import Scaled
from carosac_toolkit.loop.values import Pose
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.recordings.recording import Recording
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.validation.clocks import channel_clocks
from carosac_toolkit.validation.effect_signatures import START, effect_signatures
from carosac_toolkit.validation.quantities import say_length

SAMPLES_MIN = 60  # fewer tell no effects apart
DURATION_MIN = Scaled(15.0, "s")  # a shorter run shows too few swings
RATE_MAX = Scaled(20.0, "Hz")  # of the samples that are used
DURATION_MAX = Scaled(150.0, "s")  # of all runs that are used, of each from its start
RUN_SAMPLES_MIN = 20  # of one of several runs; a shorter one tells little
STRETCHES = 10  # of all runs, at least one of each: each is predicted from the others
START_SIZE_MIN = 1e-6  # of the largest sway at the start that fits a run, to tell it from nothing
SWAY_PHASE = "sway phase"
SLOW_SHARE = 0.5  # of the samples, the slowest, that show the noise of the sensors alone
NORMAL_SQUARE_MEDIAN = 0.4549  # median of the square of a standard normal number
FOURTH_DIFFERENCE = np.array([1.0, -4.0, 6.0, -4.0, 1.0])
NAMED_SHARE_MIN = 0.05  # of the squared error: a smaller share is not named in sentences
RIVAL_SHARE_MIN = 0.5  # of the largest share, explained alone, by an effect that may be its cause
CAUSE_SHARE_MIN = 0.1  # of the squared error that no other effect explains, for a cause


@dataclass(frozen=True, kw_only=True)
class ResidualEffects:
    """Shares of effects in a mean squared error, turns taken at the lever arm of the platform.

    Attributes:
        rms: Of the error [m].
        shares: By effect, largest first; never negative. Empty where there is no error. Of several
            recordings, `START` is what how each of them starts explains.
        ranges: By effect, what it adds to all others, and what it explains alone.
        other: Share that looks like none of them.
        jitter: Of single stamps, from lengths and poses [s]; NaN where it cannot be told.
        noise: Of the sensors, white, RMS [m].
    """

    rms: float
    shares: dict[str, float]
    ranges: dict[str, tuple[float, float]]
    other: float
    jitter: float
    noise: float

    @property
    def _effects(self) -> dict[str, float]:
        """Shares of effects of the robot and its sensors."""
        return {name: share for name, share in self.shares.items() if name != START}

    @property
    def causes(self) -> tuple[str, ...]:
        """Effects with a share that no others explain as well, largest share first."""
        return tuple(
            name
            for name, share in self._effects.items()
            if min(share, self.ranges[name][0]) >= CAUSE_SHARE_MIN
        )

    @property
    def candidates(self) -> tuple[str, ...]:
        """Effects with a share worth a word that others may explain as well.

        Where not even the largest share has a cause, all that explain nearly as much alone.
        """
        first = next(iter(self._effects), "")
        known = not first or first in self.causes
        least = np.inf if known else RIVAL_SHARE_MIN * self.shares[first]
        return tuple(
            name
            for name, share in self._effects.items()
            if (share >= NAMED_SHARE_MIN or self.ranges[name][1] >= least)
            and name not in self.causes
        )

    def data(self) -> dict[str, Any]:
        """Return all numbers under names with units, ready for JSON."""
        return {
            "rms_m": self.rms,
            "shares": self.shares,
            "added_last": {name: last for name, (last, _) in self.ranges.items()},
            "alone": {name: alone for name, (_, alone) in self.ranges.items()},
            "causes": self.causes,
            "candidates": self.candidates,
            "other": self.other,
            "jitter_s": self.jitter if np.isfinite(self.jitter) else None,
            "noise_m": self.noise,
        }

    def sentence(self, whose: str) -> str:
        """Name the effects with a share worth a word, largest first.

        Args:
            whose: Model or robot whose error it is.
        """
        if not self.shares:
            return f"There is no error of {whose} to explain."
        parts = [", ".join(f"{name} {self.shares[name]:.0%}" for name in self.causes)]
        if self.candidates:
            candidates = ", ".join(
                f"{name} ({_percents(self.ranges[name])})" for name in self.candidates
            )
            parts.append(f"candidates that cannot be told apart from others: {candidates}")
        if self.shares.get(START, 0.0) >= NAMED_SHARE_MIN:
            parts.append(f"the starts of the recordings {self.shares[START]:.0%}")
        if self.other >= NAMED_SHARE_MIN:
            parts.append(f"none of these effects {self.other:.0%}")
        return (
            f"What the error of {whose} looks like, as shares of its square "
            f"({say_length(self.rms)} RMS, turns included): {'; '.join(filter(None, parts))}."
        )


def effects_sentence(effects: ResidualEffects | str, whose: str) -> str:
    """Say what the error of a model or robot looks like, or by a reason why that cannot be told."""
    if isinstance(effects, ResidualEffects):
        return effects.sentence(whose)
    return f"What the error of {whose} looks like cannot be told: {effects}."


def _percents(ends: tuple[float, float]) -> str:
    """Say a range of shares: ``2 to 80%``."""
    low, high = min(ends), max(ends)
    return f"{max(low, 0.0) * 100.0:.0f} to {max(high, 0.0):.0%}"


@dataclass(frozen=True, kw_only=True, eq=False)
class SimulatedRun:
    """A recording, and where an open-loop simulation of it leads.

    Attributes:
        recording: As calibrated, n cables, with unstrained lengths.
        time: Increasing, within the lengths [s], shape (K,).
        measured: Poses at these times.
        modelled: Poses at these times, by a model that moves.
    """

    recording: Recording
    time: Array
    measured: Pose
    modelled: Pose

    @property
    def duration(self) -> float:
        """From the first to the last pose [s]."""
        return float(np.ptp(self.time)) if len(self.time) else 0.0


def residual_effects(robot: Robot, runs: Sequence[SimulatedRun]) -> ResidualEffects:
    """Tell which effects the errors of open-loop simulations look like.

    Effects are of the robot, the same in all recordings. How each of several recordings starts is
    fitted to its error first: what that explains is no effect of the robot, and has a share of its
    own, `START`. In one recording it is a sway phase like others.

    Args:
        robot: That was simulated.
        runs: Of recordings. Of many, some are used, the one with the largest error among them.

    Raises:
        CarosacError: Too few samples, or a robot that cannot rest on the lengths.
    """
    ratios = Scales(robot).ratios
    least = DURATION_MIN.of(ratios)
    used = _used(runs, least, DURATION_MAX.of(ratios), RATE_MAX.of(ratios))
    samples, duration = sum(len(x.time) for x in used), sum(x.duration for x in used)
    if samples < SAMPLES_MIN or duration < least:
        allowed = f"at least {SAMPLES_MIN} over {least:.3g} s, to tell effects apart"
        raise InvalidField("samples", f"{samples} over {duration:.3g} s", allowed)
    signed = [_signed(run, robot, alone=len(used) == 1) for run in used]
    speed = np.concatenate([x.speed for x in signed])
    square = float(np.concatenate([x.squares for x in signed]).mean())
    if not square > 0.0:
        return ResidualEffects(rms=0.0, shares={}, ranges={}, other=0.0, jitter=np.nan, noise=0.0)
    regression = _Regression([x.motion for x in signed], [x.error for x in signed])
    beside = float(np.concatenate([(x.error**2).sum(axis=1) for x in signed]).mean()) / square
    shares = {name: beside * share for name, share in _shares(regression).items()}
    left = regression.left(regression.names)
    jitter = _jitter([run.recording for run in used], robot)
    noise = _white(left, speed)
    pace = float((speed**2).sum(axis=1).mean())
    white = {
        "jitter": min(float(np.nan_to_num(jitter)) ** 2 * pace / square, 1.0),
        "sensor": min(noise**2 / square, 1.0),
    }
    if len(used) > 1:
        white[START] = 1.0 - beside
    ranges = {name: (beside * a, beside * b) for name, (a, b) in _ranges(regression).items()}
    ranges |= {name: (share, share) for name, share in white.items()}
    return _result(float(np.sqrt(square)), shares | white, ranges, float(jitter), noise)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Signed:
    """The error of a run and the signatures of effects, beside its start.

    Attributes:
        squares: Of the error as it is, turns included [m^2], shape (K,).
        error: Shape (K, 6).
        motion: For each effect, columns (K, 6, c).
        speed: Of the simulated motion, shape (K, 6).
    """

    squares: Array
    error: Array
    motion: dict[str, Array]
    speed: Array


def _signed(run: SimulatedRun, robot: Robot, *, alone: bool) -> _Signed:
    """Return error and signatures of a run; if it is `alone`, its start is a sway phase."""
    signatures = effect_signatures(run.recording, robot, run.time, run.modelled)
    error = _error(run.measured, run.modelled, signatures.lever)
    motion, start = dict(signatures.motion), signatures.start
    squares = (error**2).sum(axis=1)
    if alone:
        parts = [motion[SWAY_PHASE], start] if SWAY_PHASE in motion else [start]
        if parts[-1].shape[2]:
            motion[SWAY_PHASE] = np.concatenate(parts, axis=2)
        return _Signed(squares=squares, error=error, motion=motion, speed=signatures.speed)
    basis, sizes, _ = np.linalg.svd(start.reshape(error.size, -1), full_matrices=False)
    basis = basis[:, sizes > START_SIZE_MIN * sizes.max(initial=0.0)]
    return _Signed(
        squares=squares,
        error=_beside(basis, error[:, :, None])[:, :, 0],
        motion={name: _beside(basis, each) for name, each in motion.items()},
        speed=signatures.speed,
    )


def _beside(basis: Array, columns: Array) -> Array:
    """Return what an orthonormal basis (6 K, b) leaves of columns (K, 6, c)."""
    flat = columns.reshape(len(basis), -1)
    return np.asarray((flat - basis @ (basis.T @ flat)).reshape(columns.shape))


def _used(
    runs: Sequence[SimulatedRun], least: float, longest: float, rate: float
) -> list[SimulatedRun]:
    """Return the runs that are used, with as many poses as are.

    Args:
        runs: Of all recordings.
        least: Of one run that is long enough, of all of which more can be used [s].
        longest: Of all of them together [s].
        rate: Of poses, at most [Hz].
    """

    def size(run: SimulatedRun) -> float:
        away = run.modelled.position - run.measured.position
        return float((away**2).mean()) if len(away) else 0.0

    alone = len(runs) == 1
    long = [run for run in runs if alone or len(run.time) >= RUN_SAMPLES_MIN]
    ordered = sorted(long, key=size, reverse=True)
    if not ordered:
        return []
    typical = min(least, float(np.median([run.duration for run in ordered])))
    count = max(1, int(longest / typical)) if typical > 0.0 else 1
    chosen = [ordered[k] for k in evenly(len(ordered), count)]
    each = longest / len(chosen)
    return [_thinned(run, rate, each) for run in chosen]


def _thinned(run: SimulatedRun, rate: float, longest: float) -> SimulatedRun:
    """Return a run with poses of at most a rate [Hz], of a time from its start [s]."""
    time = run.time
    if not len(time):
        return run
    bins = np.floor((time - time[0]) * rate + 1e-6)
    first = np.flatnonzero(np.diff(bins, prepend=-1.0) > 0.0)
    some = first[time[first] - time[0] <= longest]
    measured, modelled = (
        Pose(position=pose.position[some], rotation=pose.rotation[some])
        for pose in (run.measured, run.modelled)
    )
    return replace(run, time=time[some], measured=measured, modelled=modelled)


def _jitter(recordings: Sequence[Recording], robot: Robot) -> float:
    """Return the RMS jitter of single stamps [s]; NaN where it cannot be told."""
    shifts = [
        clocks[0].shift
        for recording in recordings
        if (clocks := channel_clocks(recording, robot, ("poses",)))
    ]
    known = np.array([shift.jitter for shift in shifts if shift is not None])
    known = known[np.isfinite(known)]
    return float(np.sqrt((known**2).mean())) if len(known) else np.nan


def _result(
    rms: float,
    shares: dict[str, float],
    ranges: dict[str, tuple[float, float]],
    jitter: float,
    noise: float,
) -> ResidualEffects:
    """Sort the shares; where they exceed all there is, as their estimates may, scale them down."""
    known = {name: max(share, 0.0) for name, share in shares.items()}
    total = sum(known.values())
    scaled = {name: share / max(total, 1.0) for name, share in known.items()}
    return ResidualEffects(
        rms=rms,
        shares=dict(sorted(scaled.items(), key=lambda item: -item[1])),
        ranges={name: ranges[name] for name in shares},
        other=max(1.0 - total, 0.0),
        jitter=jitter,
        noise=noise,
    )


def _error(measured: Pose, modelled: Pose, lever: float) -> Array:
    """Return modelled minus measured: positions, and rotation vectors in W by a lever, (K, 6)."""
    turn = Rotation.from_matrix(modelled.rotation @ measured.rotation.swapaxes(1, 2)).as_rotvec()
    return np.hstack([modelled.position - measured.position, lever * turn])


def _shares(regression: _Regression) -> dict[str, float]:
    """Return what each effect of a regression adds to those that explain more."""
    shares = dict.fromkeys(regression.names, 0.0)
    chosen: tuple[str, ...] = ()
    explained = 0.0
    while len(chosen) < len(shares):
        others = [name for name in regression.names if name not in chosen]
        gains = {name: regression.explained((*chosen, name)) - explained for name in others}
        best = max(gains, key=lambda name: gains[name])
        if gains[best] <= 0.0:
            break
        shares[best], chosen = gains[best], (*chosen, best)
        explained += gains[best]
    return shares


def _ranges(regression: _Regression) -> dict[str, tuple[float, float]]:
    """Return what each effect of a regression adds to all others, and what it explains alone."""
    names = regression.names
    full = regression.explained(names)
    found = {}
    for name in names:
        others = [each for each in names if each != name]
        without = regression.explained(others) if others else 0.0
        found[name] = (full - without, regression.explained((name,)))
    return found


class _Regression:
    """Ridge regressions of an error on effects, each stretch predicted from the others."""

    def __init__(self, columns: Sequence[Mapping[str, Array]], errors: Sequence[Array]) -> None:
        """Put runs one after another, each with its columns (K, 6, c) and its error (K, 6)."""
        widths = {
            name: max(each[name].shape[2] for each in columns if name in each)
            for name in dict.fromkeys(name for each in columns for name in each)
        }
        self.names = tuple(widths)
        edges = np.cumsum([0, *widths.values()])
        self._where = {
            name: np.arange(a, b) for name, (a, b) in zip(widths, pairwise(edges), strict=True)
        }
        self._error = np.concatenate(list(errors))
        self._basis = np.zeros((len(self._error), 6, edges[-1]))
        self._stretches = []
        parts, first = max(1, round(STRETCHES / len(errors))), 0
        for each, error in zip(columns, errors, strict=True):
            rows = np.arange(first, first + len(error))
            for name, own in each.items():
                where = self._where[name][: own.shape[2]]
                self._basis[np.ix_(rows, np.arange(6), where)] = own
            ends = np.linspace(first, first + len(error), parts + 1).round().astype(int)
            self._stretches += [np.arange(a, b) for a, b in pairwise(ends)]
            first += len(error)
        basis = [self._basis[rows] for rows in self._stretches]
        of_stretches = [self._error[rows] for rows in self._stretches]
        self._squares = np.array([np.einsum("kic,kid->cd", b, b) for b in basis])
        self._products = np.array(
            [np.einsum("kic,ki->c", b, e) for b, e in zip(basis, of_stretches, strict=True)]
        )
        self._sizes = np.array([(e**2).sum() for e in of_stretches])

    def _ridge(self, rows: NDArray[np.intp]) -> float:
        """Return the variance of what some columns leave, errors that last counting for less.

        That is what a prior sigma of 1 weighs against in a least squares fit.
        """
        square, product = self._squares.sum(axis=0)[np.ix_(rows, rows)], self._products.sum(axis=0)
        weights = np.linalg.lstsq(square, product[rows], rcond=1e-12)[0]
        left = self._error - self._basis[:, :, rows] @ weights
        variance = max(float((left**2).mean()), 1e-6 * float((self._error**2).mean()))
        return variance * len(left) / _independent(left)

    def explained(self, names: Sequence[str]) -> float:
        """Return the share of the square that effects explain where they were not fitted."""
        rows = self._rows(names)
        ridge = self._ridge(rows)
        left = 0.0
        for k in range(len(self._stretches)):
            weights = self._weights(rows, ridge, without=k)
            square = self._squares[k][np.ix_(rows, rows)]
            left += self._sizes[k] - 2.0 * weights @ self._products[k, rows]
            left += weights @ square @ weights
        return float(1.0 - left / self._sizes.sum())

    def left(self, names: Sequence[str]) -> Array:
        """Return what effects leave where they were not fitted, (K, 6)."""
        rows = self._rows(names)
        ridge = self._ridge(rows)
        parts = [
            self._error[stretch]
            - self._basis[stretch][:, :, rows] @ self._weights(rows, ridge, without=k)
            for k, stretch in enumerate(self._stretches)
        ]
        return np.concatenate(parts)

    def _rows(self, names: Sequence[str]) -> NDArray[np.intp]:
        return np.concatenate([self._where[name] for name in names])

    def _weights(self, rows: NDArray[np.intp], ridge: float, *, without: int) -> Array:
        """Return the sizes of effects in prior sigmas, from all stretches but one."""
        square = (self._squares.sum(axis=0) - self._squares[without])[np.ix_(rows, rows)]
        product = (self._products.sum(axis=0) - self._products[without])[rows]
        return np.asarray(np.linalg.solve(square + ridge * np.eye(len(rows)), product))


def _independent(error: Array) -> float:
    """Return how many of K errors count as independent, by their autocorrelation."""
    count = len(error)
    spectrum = np.fft.rfft(error - error.mean(axis=0), 2 * count, axis=0)
    power = np.fft.irfft(np.abs(spectrum) ** 2, axis=0).sum(axis=1)[: count // 2]
    correlation = power / max(float(power[0]), np.finfo(np.float64).tiny)
    return count / (1.0 + 2.0 * float(np.maximum(correlation[1:] ** 2 - 1.0 / count, 0.0).sum()))


def _white(left: Array, speed: Array) -> float:
    """Return the RMS of the white noise in errors (K, 6) where the platform is slow.

    Fourth differences leave hardly anything of a swing; medians ignore single events.
    """
    rows = np.arange(len(left) - len(FOURTH_DIFFERENCE) + 1)
    differences = sum(
        weight * left[rows + k] for k, weight in enumerate(FOURTH_DIFFERENCE)
    ) / np.linalg.norm(FOURTH_DIFFERENCE)
    pace = (speed[rows + 2] ** 2).sum(axis=1)
    slow = pace <= np.quantile(pace, SLOW_SHARE)
    squares = np.median(np.asarray(differences)[slow] ** 2, axis=0) / NORMAL_SQUARE_MEDIAN
    return float(np.sqrt(squares.sum()))
