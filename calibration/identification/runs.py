"""Recordings whose poses one robot is fitted to."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.polynomial.legendre import legvander
from scipy.linalg import cholesky_banded, solve_banded
from scipy.sparse import csr_array
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from calibration.identification.measured_poses import MeasuredPoses
from calibration.identification.sway import FreeSway
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.physics.rest.modes import natural_frequencies
from carosac_toolkit.physics.rest.statics import Equilibrium
from carosac_toolkit.recordings.length_path import LengthPath
from carosac_toolkit.robot.robot import Robot

# Of Blackman and Harris: cosines of multiples, which leave 3e-5 of vibrations. A thousandth would
# still tell a stiffness by their phase.
WINDOW = (0.35875, 0.48829, 0.14128, 0.01168)
WINDOW_PERIODS = 4.0  # of the slowest vibration, from where it leaves so little
AVERAGES_PER_WINDOW = 5  # begin within one, or as many as poses may be fitted
# In the fastest sway, or it is not seen: with five a window, two periods in one. Vibrations of less
# than twice its frequency shake it besides, and have to be followed.
AVERAGES_PER_SWAY_MIN = 2.5
NOISE_ALONE_SHARE = 1e-3  # of the variance of an average, that it has in common with no other
WINDOW_POSES_MIN = 8  # poses in a window
WINDOW_POSES_MAX = 50  # in the shortest of all windows
# Degree of polynomials that follow a sway within a window to a thousandth, and no vibration: of a
# sway that lasts, and for each of its periods.
SWAY_DEGREE, SWAY_DEGREE_PER_PERIOD = 3, 4
RINGING_RATIO_MIN = 1.5  # of the scatter within later windows: more is vibration
RINGING_WINDOWS = 2.25  # in which sway and vibrations are told apart, in windows of averages
CHANCE = 1e-5  # that noise alone scatters so much in a window
CALM_WINDOWS = 4  # in a row, as many a window: vibrations have died out
RINGING_SHARE_MAX = 0.5  # of a recording: one that vibrates for longer is fitted from there on
PERIODS_BEFORE = 0.5  # of the slowest sway
LEADING_SHARE_MAX = 0.3  # of the poses
LOCKED_SHARE_MAX = 1e-3  # of a length, by which one of a locked winch seems to change
LOCKED_TIMES = 11  # at which that is looked at
# Of the weight that poses have in a typical window; a window with less lets vibrations in.
COVERED_SHARE_MIN = 0.8


@dataclass(frozen=True, kw_only=True, eq=False)
class FittedRun:
    """A recording, as a fit sees it.

    Attributes:
        path: Readings.
        poses: Measured ones that may be fitted.
        rate: Of poses that are fitted, of all of them [Hz].
        sway: Unknown motion at the start.
        window: Time over which errors are averaged [s]; 0: none.
        leading: Time at first whose poses lead the search, and do not count at its end [s].
        averaged_rate: Of poses that are averaged, at most [Hz]. One for all runs, as else poses of
            one would count for more than those of another.
    """

    path: LengthPath
    poses: MeasuredPoses
    rate: float
    sway: FreeSway
    window: float = 0.0
    leading: float = 0.0
    averaged_rate: float = math.inf

    @property
    def begin(self) -> float:
        """When its simulation begins [s]."""
        return self.path.first if self.sway.begin is None else self.sway.begin

    def first(self, share: float) -> FittedRun:
        """Return the run with the poses of a share of it, from the first; 1: with all that count.

        Where errors are averaged nearly all poses count. Otherwise as many as are fitted of the
        whole, if they were measured so often: vibrations are followed from their beginning.
        """
        time = self.poses.time
        leading = self.leading if share == 1.0 else 0.0
        span = time - time[0]
        rows = np.flatnonzero((span >= leading) & (span <= share * span[-1]))
        poses = self.poses.rows(rows)
        rate = self.averaged_rate if self.window else self.rate / share
        return replace(self, poses=poses.thinned(rate), leading=self.leading - leading)

    def seen(self, errors: Array) -> Array:
        """Return errors (K, 6) of all poses as a fit sees them, shape (K', 6).

        Averages over windows that overlap have noise in common. They are taken together so that
        noise of each is its own, as large as that of an average.
        """
        if not self.window:
            return errors
        averages, apart = self._averages
        return np.asarray(solve_banded((len(apart) - 1, 0), apart, averages @ errors))

    @cached_property
    def _averages(self) -> tuple[csr_array, Array]:
        """Weights with which errors are averaged (K', K), and what these have in common.

        That is the root of their covariance under noise of each pose, over their mean variance:
        the bands of a lower triangle, shape (b, K'). Windows with a gap are left out.
        """
        time, half = self.poses.time, 0.5 * self.window
        step = spacing(self.window, self.rate)
        count = int(max(0.0, time[-1] - time[0] - self.window) / step) + 1
        center = time[0] + half + step * np.arange(count)
        first, stop = (np.searchsorted(time, center + side) for side in (-half, half))
        row = np.repeat(np.arange(count), stop - first)
        column = np.concatenate([np.arange(a, b) for a, b in zip(first, stop, strict=True)])
        away = np.pi * (time[column] - center[row]) / half
        weight = sum(share * np.cos(k * away) for k, share in enumerate(WINDOW))
        total = np.bincount(row, weight, count)
        kept = (total > 0.0) & (total >= COVERED_SHARE_MIN * np.median(total))
        shape = (count, len(time))
        averages = csr_array((weight / np.maximum(total, 1e-9)[row], (row, column)), shape=shape)
        averages = averages[kept]
        common = averages @ averages.T
        bands = np.zeros((AVERAGES_PER_WINDOW, int(kept.sum())))
        for below in range(min(bands.shape)):
            bands[below, : bands.shape[1] - below] = common.diagonal(-below)
        bands /= bands[0].mean()
        bands[0] += NOISE_ALONE_SHARE
        return averages, cholesky_banded(bands, lower=True)


def spacing(window: float, rate: float) -> float:
    """Return how far averages over a window [s] are apart, if a rate [Hz] of poses is fitted."""
    return max(window / AVERAGES_PER_WINDOW, 1.0 / rate)


def slow_window(robot: Robot, rest: Equilibrium, time: Array, rate: float) -> float:
    """Return over which time errors are averaged [s], so that only the sway is seen; 0: none.

    A platform on less than six cables sways slowly, and vibrates fast on its elastic cables. How
    these vibrations go on for hundreds of periods, only a stiffness shows that is known to a
    thousandth: any other one has a best solution of its own, which claims to be just as well known.

    Args:
        robot: Robot description, n cables.
        rest: Its equilibrium on the first lengths, B = 1.
        time: Of the poses [s], shape (K,).
        rate: Of poses that are fitted, at most [Hz].
    """
    if robot.n >= 6:
        return 0.0
    slow, fast = natural_frequencies(robot, rest)[0, [5 - robot.n, 6 - robot.n]]
    window = WINDOW_PERIODS / fast
    seen = AVERAGES_PER_SWAY_MIN * slow * spacing(window, rate) <= 1.0
    if not seen or len(time) < 2 or window < WINDOW_POSES_MIN * np.median(np.diff(time)):
        return 0.0
    return float(window)


def averaged_rate(windows: Sequence[float]) -> float:
    """Return the rate [Hz] of poses that are averaged over windows [s], none of which is 0."""
    return WINDOW_POSES_MAX / min(windows)


def fastest_sway(robot: Robot, rest: Equilibrium) -> float:
    """Return the frequency of the fastest sway of less than six cables [Hz]."""
    return float(natural_frequencies(robot, rest)[0, 5 - robot.n])


def time_before(robot: Robot, rest: Equilibrium) -> float:
    """Return how long before its first pose a recording with locked winches is simulated [s].

    Dry friction remembers how a platform moved before. Half a sway leaves it what it remembers.
    """
    return PERIODS_BEFORE / float(natural_frequencies(robot, rest)[0, 0])


def leading_time(before: float, poses: MeasuredPoses) -> float:
    """Return for how long poses at first lead a search, and do not count at its end [s].

    Vibrations that noise hides shake dry friction loose, and dry friction that has not slid
    remembers for longer than half a sway how it was bent.

    Args:
        before: Time for which the recording is simulated before its first pose [s].
        poses: Measured ones, once vibrations have died out as far as is seen.
    """
    most = float(np.quantile(poses.time, LEADING_SHARE_MAX) - poses.time[0])
    return min(before, most)


def is_locked(path: LengthPath, last: float) -> bool:
    """Return True if winches hold still from the first reading to some time [s]."""
    lengths = path.at(np.linspace(path.first, last, LOCKED_TIMES))
    return bool((np.ptp(lengths, axis=0) <= LOCKED_SHARE_MAX * np.abs(lengths[0])).all())


def without_ringing(poses: MeasuredPoses, window: float, sway: float) -> MeasuredPoses:
    """Return the poses of a recording from when its vibrations have died out.

    What kicks a platform shakes its cables too. While they vibrate they change the sway, in strong
    swings by more than noise, and nothing at the start of a fit stands for them.

    Args:
        poses: Measured ones.
        window: Over which errors are averaged [s].
        sway: Frequency of the fastest sway [Hz].
    """
    length = RINGING_WINDOWS * window
    degree = sway_degree(length, sway)
    begin, scatter, freedoms = _scatter(poses, length, degree)
    if not len(begin):
        return poses
    first, last = poses.time[0], poses.time[-1]
    latest = float(first + RINGING_SHARE_MAX * (last - first))
    typical = np.median(scatter[len(begin) // 2 :], axis=0)
    limit = np.maximum(RINGING_RATIO_MIN, chi2.isf(CHANCE, 3 * freedoms) / (3 * freedoms))
    rings = np.asarray((scatter > limit[:, None] * typical).any(axis=1))
    calm = [k for k in range(len(rings)) if not rings[k : k + CALM_WINDOWS].any()]
    since = min(begin[calm[0]], latest) if calm else latest
    return poses.rows(np.flatnonzero(poses.time >= since))


def sway_degree(time: float, sway: float) -> int:
    """Return the degree of polynomials that follow a sway for some time [s], and no vibration.

    Args:
        time: For how long.
        sway: Frequency of the fastest sway [Hz].
    """
    return SWAY_DEGREE + math.ceil(SWAY_DEGREE_PER_PERIOD * time * sway)


def sway_basis(time: Array, span: float, degree: int) -> Array:
    """Return orthonormal polynomials of a sway over 0 to `span` [s] in columns, (K, degree + 1)."""
    return np.asarray(np.linalg.qr(legvander(2.0 * time / span - 1.0, degree))[0])


def _scatter(poses: MeasuredPoses, window: float, degree: int) -> tuple[Array, Array, Array]:
    """Return how positions and rotations scatter in windows about polynomials of a degree.

    Returns:
        When windows begin [s], shape (K,); the variances of both, shape (K, 2); and how many
        freedoms each component has, shape (K,).
    """
    begins, scatters, freedoms = [], [], []
    begin = float(poses.time[0])
    while begin + window <= poses.time[-1]:
        rows = np.flatnonzero((poses.time >= begin) & (poses.time < begin + window))
        if len(rows) > degree + 1:
            turn = poses.rotation[rows[0]].T @ poses.rotation[rows]
            motion = np.hstack([poses.position[rows], Rotation.from_matrix(turn).as_rotvec()])
            basis = sway_basis(poses.time[rows] - begin, window, degree)
            left = motion - basis @ (basis.T @ motion)
            freedoms.append(len(rows) - degree - 1)
            begins.append(begin)
            scatters.append((left**2).sum(axis=0).reshape(2, 3).sum(axis=1) / freedoms[-1])
        begin += window / CALM_WINDOWS
    return np.array(begins), np.array(scatters).reshape(-1, 2), np.array(freedoms)
