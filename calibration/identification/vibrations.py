"""Vibrations that noise hides, and what they change of a sway, counted as noise of its own.

A platform that was kicked vibrates on its elastic cables long after that is seen in single poses.
Averages leave nothing of such a vibration. Yet it shakes dry friction loose and pulls at the cables
on average, and the sway drifts by as much as poses tell of it: fits that knew nothing of it would
find other dampings, and claim to know them.

How a platform vibrates, all of its poses together say better than single ones: the first that count
are compared with those of simulated platforms whose cables start a little longer or shorter. A
regression tells how strongly, and from that, as of any coordinates of known variance, which start
is likeliest and how far off it may be. Simulated platforms that start about it to both sides show
how far the sway drifts: errors are corrected by their mean drift, and what they scatter about it is
V in a further covariance V V^T of the errors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

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
# Of the power that a regression explains: less of it in the simulation, and it is not believed.
CONFIRMED_SHARE = 0.5
REFINED = 2  # steps that those of a sway are divided into, for what vibrates
HALVINGS_MAX = 3  # of vibrations with which a platform has no finite motion
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

    def points(self, at: Array, along: Array) -> Array:
        """Return coordinates of the run, first without vibrations, (1 + W, p + 2 n).

        Args:
            at: Those without them, shape (p,).
            along: How strongly the run starts in each of the ways, in rows, shape (W, 2 n).
        """
        vibrating = np.concatenate([np.zeros((1, len(self.ways))), along @ self.ways])
        return np.hstack([np.tile(at, (len(vibrating), 1)), vibrating])

    @property
    def highest(self) -> float:
        """The level at which a cable hangs loose in between, in one of the ways."""
        elongation, rate = np.split(self.ways, 2, axis=1)
        return SLACK / float(np.hypot(elongation, rate).max())

    def posterior(self, errors: Array) -> VibrationPosterior:
        """Return what poses tell of the vibrations from which they come.

        Of coordinates of variance L^2, a regression on the d = 2 n ways explains d + L^2 tr(A) / d
        in the mean, in variances of noise, where A is the information on coefficients of the ways.
        What is more than d is never taken for less than its sigma without vibrations. Where poses
        tell nothing, as vibrations die out before they count or poses are too few, the level is the
        highest; vibrations that are seen may let cables hang loose for a moment.

        Args:
            errors: At the level `PROBE` of each way, as of `points`, of all poses, shape
                (1 + 2 n, K, 6).
        """
        missed, freedoms = _fast(self.run, -errors[0])
        count = len(self.ways)
        if 6 * freedoms < FREEDOMS_MIN * count:
            return VibrationPosterior(
                level=self.highest, information=np.zeros((count, count)), pull=np.zeros(count),
                scatter=np.ones(6),
            )  # fmt: skip
        slopes = _fast(self.run, errors[1:] - errors[0])[0].reshape(count, -1).T / PROBE
        left = missed
        for fitted in (0, count):  # vibrations that are seen are no noise
            power = (left.reshape(-1, 2, 3) ** 2).sum(axis=(0, 2))
            sides = np.sqrt(power / (3 * freedoms - 0.5 * fitted))  # of positions, rotations
            sigma = np.tile(np.repeat(sides, 3), len(missed))
            scaled, wanted = slopes / sigma[:, None], missed.ravel() / sigma
            best = np.linalg.lstsq(scaled, wanted, rcond=None)[0]
            left = missed - (slopes @ best).reshape(missed.shape)
        information = scaled.T @ scaled
        explained, told = float(best @ information @ best), float(np.trace(information)) / count
        chance = float(np.sqrt(2.0 * count))
        strength = max(explained - count, chance)
        level = float(np.sqrt(strength / max(told, TINY)))
        seen = strength > SEEN_SIGMAS * chance and level < 2.0 * SLACK
        return VibrationPosterior(
            level=min(level, SLACK if seen else self.highest), information=information,
            pull=scaled.T @ wanted, scatter=np.repeat(sides, 3),
        )  # fmt: skip


@dataclass(frozen=True, kw_only=True, eq=False)
class VibrationPosterior:
    """What the poses of a run tell of how strongly it starts in each of d ways to vibrate.

    Attributes:
        level: Sigma before of each coordinate of the start; of the coefficients of the d ways it is
            this over the root of d.
        information: On the coefficients, shape (d, d).
        pull: Information times their estimate from poses alone, shape (d,).
        scatter: Of positions [m] and rotations [rad] beside them, shape (6,).
    """

    level: float
    information: Array
    pull: Array
    scatter: Array

    def sigma_points(self) -> Array:
        """Return the likeliest coefficients, and others to both sides that scatter as they may.

        Shape (1 + 2 d, d); the covariance of the others about the likeliest is the posterior one.
        """
        count = len(self.pull)
        precision = self.information + count / self.level**2 * np.eye(count)
        root = np.linalg.inv(np.linalg.cholesky(precision))  # root^T root is the covariance
        best, off = root.T @ (root @ self.pull), np.sqrt(count) * root
        return np.concatenate([best[None], best + off, best - off])

    def is_confirmed(self, run: FittedRun, errors: Array) -> bool:
        """Say whether simulated vibrations explain of the poses what a regression promised.

        They do not far from linear, where cables go slack or phases depend on the amplitude.

        Args:
            run: With all poses.
            errors: Of a calm start, of the likeliest one, and of others, shape (2 + W, K, 6).
        """
        best = self.sigma_points()[0]
        promised = float((2.0 * self.pull - self.information @ best) @ best)
        calm, likeliest = (
            float(((_fast(run, each)[0] / self.scatter) ** 2).sum()) for each in errors[:2]
        )
        return calm - likeliest >= CONFIRMED_SHARE * promised

    @property
    def forgotten(self) -> VibrationPosterior:
        """The same where poses tell the level alone."""
        return replace(self, information=0.0 * self.information, pull=0.0 * self.pull)


@dataclass(frozen=True, kw_only=True, eq=False)
class HiddenVibrations:
    """What vibrations that noise hides change of the errors of a run.

    Attributes:
        drift: Of errors, the mean over what vibrations may be, shape (K, 6). Errors are corrected
            by it.
        spread: V in the covariance V V^T of what that may be wrong by, shape (6 K, 2 d); (6 K, 0)
            where nothing is hidden.
    """

    drift: Array
    spread: Array

    @classmethod
    def none(cls, errors: Array) -> HiddenVibrations:
        """Return those of a run with errors (K, 6) that nothing hidden changes."""
        return cls(drift=np.zeros_like(errors), spread=np.zeros((errors.size, 0)))


def hidden_vibrations(
    simulator: RunSimulator,
    runs: Sequence[FittedRun],
    counted: Sequence[FittedRun],
    at: Sequence[Array],
    robot: Robot,
    time_step: float,
) -> list[HiddenVibrations]:
    """Return what hidden vibrations change of the errors of runs.

    Args:
        simulator: Of the robot.
        runs: With all poses. Vibrations are no unknowns of their starts.
        counted: The same with the poses that count.
        at: Coordinates of each run, those of the robot first.
        robot: At these coordinates.
        time_step: Of a sway, at most [s].

    Raises:
        CarosacError: A platform has no finite motion, as little as it vibrates.
    """
    rng = np.random.default_rng(SEED)
    starts = [VibratingStarts.of(run, robot, rng) for run in runs]

    every = [start.run for start in starts]

    def errors_at(along: Sequence[Array]) -> tuple[list[Array], list[bool]]:
        points = [start.points(*each) for start, *each in zip(starts, at, along, strict=True)]
        errors, sound = simulator.pose_errors(every, points, time_step, refined=REFINED)
        return errors, [bool(each.all()) for each in sound]

    probed, sound = errors_at([PROBE * np.eye(len(start.ways)) for start in starts])
    if not all(sound):
        raise CarosacError("identification: no finite motion of the robot on cables that vibrate")
    posteriors = [start.posterior(errors) for start, errors in zip(starts, probed, strict=True)]
    points = [each.sigma_points() for each in posteriors]
    vibrating, sound = errors_at(points)
    kept = [
        fine and each.is_confirmed(run, errors)
        for each, run, errors, fine in zip(posteriors, every, vibrating, sound, strict=True)
    ]
    if not all(kept):  # so far from linear poses tell no more than a level
        points = [
            along if likely else each.forgotten.sigma_points()
            for each, along, likely in zip(posteriors, points, kept, strict=True)
        ]
        vibrating, sound = errors_at(points)
    for _ in range(HALVINGS_MAX):
        if all(sound):
            break
        points = [along if fine else 0.5 * along for along, fine in zip(points, sound, strict=True)]
        vibrating, sound = errors_at(points)
    if not all(sound):
        raise CarosacError("identification: no finite motion of the robot on cables that vibrate")
    hidden = []
    for run, part, errors in zip(runs, counted, vibrating, strict=True):
        rows = np.isin(run.poses.time, part.poses.time)
        calm, _, *others = [part.seen(each[rows]) for each in errors]
        likely = np.mean(others, axis=0)
        off = np.array(others) - likely
        spread = off.reshape(len(off), -1).T / np.sqrt(len(off))
        hidden.append(HiddenVibrations(drift=likely - calm, spread=spread))
    return hidden


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
