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
from numpy.typing import NDArray

from calibration.identification.open_loop import first_equilibrium
from calibration.identification.run_simulator import RunSimulator
from calibration.identification.runs import FittedRun, sway_basis, sway_degree
from calibration.identification.sway import stretch_sigma
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import CarosacError
from carosac_toolkit.robot.robot import Robot

# Levels of vibrations are of the prior sigma of elongations, which is twice those at rest.
PROBE = 0.03  # level so low that poses follow in proportion
SLACK = 0.5  # elongations at which a cable hangs loose in between
SEEN_WINDOWS = 2.0  # in which vibrations are looked for: for longer, phases are lost
SEEN_SIGMAS = 3.0  # of the power that noise explains: more are vibrations for sure
FREEDOMS_MIN = 4.0  # of poses that tell a level, for each way to vibrate
REFINED = 2  # steps that those of a sway are divided into, for what vibrates
HALVINGS_MAX = 3  # of a level at which a platform has no finite motion
TINY = 1e-12  # instead of no information
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

    @property
    def highest(self) -> float:
        """The level at which a cable hangs loose in between, in one of the ways."""
        elongation, rate = np.split(self.ways, 2, axis=1)
        return SLACK / float(np.hypot(elongation, rate).max())

    def level(self, errors: Array) -> float:
        """Return the level from which poses come, by the power that vibrations explain.

        Of coordinates of variance L^2, a regression on the d = 2 n ways explains d + L^2 tr(A) / d
        in the mean, in variances of noise, where A is the information on coefficients of the ways.
        What is more than d is never taken for less than its sigma without vibrations. Where poses
        tell nothing, as vibrations die out before they count or poses are too few, the level is the
        highest; vibrations that are seen may let cables hang loose for a moment.

        Args:
            errors: At the level `PROBE`, as of `points`, of all poses, shape (1 + 2 n, K, 6).
        """
        missed, freedoms = _fast(self.run, -errors[0])
        count = len(self.ways)
        if 6 * freedoms < FREEDOMS_MIN * count:
            return self.highest
        slopes = _fast(self.run, errors[1:] - errors[0])[0].reshape(count, -1).T / PROBE
        left = missed
        for fitted in (0, count):  # vibrations that are seen are no noise
            power = (left.reshape(-1, 2, 3) ** 2).sum(axis=(0, 2))
            sides = np.sqrt(power / (3 * freedoms - 0.5 * fitted))  # of positions, rotations
            sigma = np.tile(np.repeat(sides, 3), len(missed))
            best = np.linalg.lstsq(slopes / sigma[:, None], missed.ravel() / sigma, rcond=None)[0]
            left = missed - (slopes @ best).reshape(missed.shape)
        explained = float(((slopes @ best / sigma) ** 2).sum())
        told = float(((slopes / sigma[:, None]) ** 2).sum()) / count
        chance = float(np.sqrt(2.0 * count))
        strength = max(explained - count, chance)
        level = float(np.sqrt(strength / max(told, TINY)))
        seen = strength > SEEN_SIGMAS * chance and level < 2.0 * SLACK
        return min(level, SLACK if seen else self.highest)


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

    Raises:
        CarosacError: A platform has no finite motion, as little as it vibrates.
    """
    rng = np.random.default_rng(SEED)
    starts = [VibratingStarts.of(run, robot, rng) for run in runs]

    def errors_at(levels: Sequence[float]) -> tuple[list[Array], list[NDArray[np.bool_]]]:
        points = [
            start.points(own, level) for start, own, level in zip(starts, at, levels, strict=True)
        ]
        every = [start.run for start in starts]
        return simulator.pose_errors(every, points, time_step, refined=REFINED)

    probed, sound = errors_at([PROBE] * len(runs))
    if not all(each.all() for each in sound):
        raise CarosacError("identification: no finite motion of the robot on cables that vibrate")
    levels = [start.level(errors) for start, errors in zip(starts, probed, strict=True)]
    for _ in range(HALVINGS_MAX):
        vibrating, sound = errors_at(levels)
        lost = [not each.all() for each in sound]
        if not any(lost):
            break
        levels = [
            max(PROBE, level / 2.0) if half else level
            for level, half in zip(levels, lost, strict=True)
        ]
    else:
        raise CarosacError("identification: no finite motion of the robot on cables that vibrate")
    drifts = []
    for run, part, errors in zip(runs, counted, vibrating, strict=True):
        rows = np.isin(run.poses.time, part.poses.time)
        calm, *others = [part.seen(each[rows]).ravel() for each in errors]
        drifts.append((np.array(others) - calm).T / np.sqrt(len(others)))
    return drifts


def _fast(run: FittedRun, errors: Array) -> tuple[Array, int]:
    """Return what no sway makes of errors, from the first poses that count on.

    Args:
        run: With all poses.
        errors: Of these, shape (..., K, 6).

    Returns:
        shape (..., K', 6); and how many freedoms are left of each component.
    """
    since = run.poses.time - run.poses.time[0] - run.leading
    time = since - np.min(since, where=since >= 0.0, initial=np.inf)
    rows = (time >= 0.0) & (time <= SEEN_WINDOWS * run.window)
    span = float(time[rows][-1])
    degree = sway_degree(span, float(run.sway.frequency.max()) / (2.0 * np.pi))
    if rows.sum() <= degree + 1:
        return errors[..., :0, :], 0
    basis = sway_basis(time[rows], span, degree)
    seen = errors[..., rows, :]
    return np.asarray(seen - basis @ (basis.T @ seen)), int(rows.sum()) - degree - 1
