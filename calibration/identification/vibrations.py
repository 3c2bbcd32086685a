"""Vibrations that noise hides, and what they change of a sway, counted as noise of its own.

A platform that was kicked vibrates on its elastic cables long after that is seen in single poses.
Averages leave nothing of such a vibration. Yet it shakes dry friction loose and pulls at the cables
on average, and the sway drifts by as much as poses tell of it: fits that knew nothing of it would
find other dampings, and claim to know them.

How strongly a platform vibrates, all of its poses together say better than single ones: the first
that count are compared with those of simulated platforms whose cables start a little longer or
shorter. Its phase would not outlast an error of a frequency, and the sway hardly asks for it:
simulated platforms that vibrate as strongly, each in a way of its own, show how far the sway may
drift. Their drifts are the columns of V in a further covariance V V^T of the errors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial.legendre import legvander
from numpy.typing import NDArray
from scipy.stats import gamma

from calibration.identification.open_loop import first_equilibrium
from calibration.identification.run_simulator import RunSimulator
from calibration.identification.runs import FittedRun, sway_degree
from calibration.identification.sway import stretch_sigma
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.robot.robot import Robot

# Of the prior sigma of elongations, which is twice those at rest: at more than half of it cables
# would hang loose.
PROBE = 0.03  # little enough that poses follow in proportion
LEVELS = np.geomspace(1e-3, 0.5, 60)
SEEN_WINDOWS = 2.0  # at first, in which vibrations are looked for: for longer, phases are lost
REFINED = 2  # steps that those of a sway are divided into, for what vibrates
SEED = 0


@dataclass(frozen=True, kw_only=True, eq=False)
class VibratingStarts:
    """Starts of a run, without vibrations first and then with them.

    Attributes:
        run: With all its poses, and elongations among the coordinates of its start.
        ways: Elongations of the n cables, then their rates, over their prior sigmas, in rows;
            orthogonal, with a mean square of 1 in each, shape (2 n, 2 n).
    """

    run: FittedRun
    ways: Array

    @classmethod
    def of(cls, run: FittedRun, robot: Robot, rng: np.random.Generator) -> VibratingStarts:
        """Draw ways in which a run may start beside its sway."""
        sigma = stretch_sigma(robot, first_equilibrium(robot, run.path))
        ways, _ = np.linalg.qr(rng.standard_normal((len(sigma), len(sigma))))
        sway = replace(run.sway, stretch_sigma=sigma)
        return cls(run=replace(run, sway=sway), ways=np.sqrt(len(sigma)) * ways)

    def points(self, at: Array, level: float) -> Array:
        """Return coordinates of the run at a level of vibrations, (1 + 2 n, p + 2 n).

        Args:
            at: Those without them, shape (p,).
            level: Of prior sigmas.
        """
        none = np.zeros((1, len(self.ways)))
        vibrating = level * np.concatenate([none, self.ways])
        return np.hstack([np.tile(at, (len(vibrating), 1)), vibrating])


def hidden_vibrations(
    simulator: RunSimulator,
    runs: Sequence[FittedRun],
    counted: Sequence[FittedRun],
    at: Sequence[Array],
    robot: Robot,
    time_step: float,
) -> list[Array]:
    """Return what hidden vibrations change of the errors of runs, each column by one sigma.

    Args:
        simulator: Of the robot.
        runs: With all poses. Vibrations are no unknowns of their starts.
        counted: The same with the poses that count.
        at: Coordinates of each run, those of the robot first.
        robot: At these coordinates.
        time_step: Of a sway, at most [s].

    Returns:
        Of each run, shape (6 K, 2 n).
    """
    rng = np.random.default_rng(SEED)
    starts = [VibratingStarts.of(run, robot, rng) for run in runs]

    def errors_at(levels: Sequence[float]) -> tuple[list[Array], list[NDArray[np.bool_]]]:
        points = [
            start.points(own, level) for start, own, level in zip(starts, at, levels, strict=True)
        ]
        every = [start.run for start in starts]
        return simulator.pose_errors(every, points, time_step, refined=REFINED)

    probed, _ = errors_at([PROBE] * len(runs))
    levels = [vibration_level(run, errors) for run, errors in zip(runs, probed, strict=True)]
    found = []
    for run, part, errors, exists in zip(runs, counted, *errors_at(levels), strict=True):
        rows = np.isin(run.poses.time, part.poses.time)
        calm, *others = [part.seen(each[rows]).ravel() for each in errors]
        drifts = np.where(exists[1:], np.array(others).T - calm[:, None], 0.0)
        found.append(drifts / np.sqrt(max(1, exists[1:].sum())))
    return found


def vibration_level(run: FittedRun, errors: Array) -> float:
    """Return how strongly a platform vibrates at its start, of prior sigmas.

    The root of the mean square of all levels from which its poses may come, each as likely before.

    Args:
        run: With all poses.
        errors: Without vibrations first, then with each of those that are probed, (1 + d, K, 6).
    """
    missed, ways = _fast(run, -errors[0]), _fast(run, errors[1:] - errors[0]) / PROBE
    slopes, left = ways.reshape(len(ways), -1).T, missed
    for _ in range(2):  # vibrations that are seen are no noise
        sides = np.sqrt((left.reshape(-1, 2, 3) ** 2).mean(axis=(0, 2)))
        sigma = np.tile(np.repeat(sides, 3), len(missed))
        best = np.linalg.lstsq(slopes / sigma[:, None], missed.ravel() / sigma, rcond=None)[0]
        left = missed - (slopes @ best).reshape(missed.shape)
    over = slopes / sigma[:, None]
    told = np.linalg.eigvalsh(over.T @ over)
    power = float(((slopes @ best / sigma) ** 2).sum())  # that vibrations explain
    grown = 1.0 + LEVELS[:, None] ** 2 * told  # mean of its parts, which noise alone has as 1
    mean, variance = grown.sum(axis=1), 2.0 * (grown**2).sum(axis=1)
    logarithm = gamma.logpdf(power, mean**2 / variance, scale=variance / mean)
    likely = np.exp(logarithm - logarithm.max()) * LEVELS  # levels come at equal ratios
    return float(np.sqrt((likely * LEVELS**2).sum() / likely.sum()))


def _fast(run: FittedRun, errors: Array) -> Array:
    """Return what no sway makes of errors (..., K, 6), of poses that count first, (..., K', 6)."""
    time = run.poses.time - run.poses.time[0] - run.leading
    rows = (time >= 0.0) & (time <= SEEN_WINDOWS * run.window)
    first, last = time[rows][[0, -1]]
    degree = sway_degree(last - first, float(run.sway.frequency.max()) / (2.0 * np.pi))
    basis = np.linalg.qr(legvander(2.0 * (time[rows] - first) / (last - first) - 1.0, degree))[0]
    seen = errors[..., rows, :]
    return np.asarray(seen - basis @ (basis.T @ seen))
