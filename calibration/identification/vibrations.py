"""Vibrations that noise hides, and what they change of a sway, counted as noise of its own.

A platform that was kicked vibrates on its elastic cables long after that is seen in single poses.
Averages leave nothing of such a vibration. Yet it shakes dry friction loose and pulls at the cables
on average, and the sway drifts by as much as poses tell of it: fits that knew nothing of it would
find other dampings, and claim to know them.

How a platform vibrates, all of its poses together say better than single ones: they are compared
with those of simulated platforms whose cables start a little longer or shorter, first for a short
while, in which phases are not lost yet, then for longer (Gauss-Newton). That tells, as of any
coordinates of known variance, which start is likeliest and how far off it may be. Simulated
platforms that start about it to both sides show how far the sway drifts: errors are corrected by
their mean drift, and what they scatter about it is V in a further covariance V V^T of the errors.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import f

from calibration.identification.open_loop import first_equilibrium
from calibration.identification.quadratic import Quadratic
from calibration.identification.runs import FittedRun, sway_basis, sway_degree
from calibration.identification.sway import stretch_sigma
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.robot.robot import Robot

# Levels of vibrations are of the prior sigma of elongations, which is twice those at rest.
PROBE = 0.01  # level so low that poses follow in proportion
SLACK = 0.5  # elongations at which a cable hangs loose in between
SEEN_WINDOWS = 2.0  # after the leading poses, until when vibrations are looked for
SEEN_SIGMAS = 3.0  # of the power that noise explains: more are vibrations for sure
LOST_SCATTER_RATIO = 1.3  # of what vibrations leave of poses, beyond which they are lost
CHANCE = 1e-3  # that noise alone exceeds that
# Of the power of the likeliest vibrations: poses that show less of it do not show them.
SHOWN_SHARE = 0.5
FREEDOMS_MIN = 4.0  # of poses that tell a level, for each way to vibrate
REFINED = 2  # steps that those of a sway are divided into, for what vibrates
TINY = 1e-12  # instead of no information


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
        """Return coordinates of the run, (W, p + 2 n).

        Args:
            at: Those without vibrations, shape (p,).
            along: How strongly the run starts in each of the ways, in rows, shape (W, 2 n).
        """
        return np.hstack([np.tile(at, (len(along), 1)), along @ self.ways])

    def first(self, share: float) -> VibratingStarts:
        """Return the same of a share of the time in which vibrations are looked for."""
        run = self.run
        last = share * (run.leading + SEEN_WINDOWS * run.window)
        rows = np.flatnonzero(run.poses.time - run.poses.time[0] <= last)
        return replace(self, run=replace(run, poses=run.poses.rows(rows)))

    @property
    def highest(self) -> float:
        """The level at which a cable hangs loose in between, in one of the ways."""
        elongation, rate = np.split(self.ways, 2, axis=1)
        return SLACK / float(np.hypot(elongation, rate).max())

    def told(self, about: Array, errors: Array, cable_probe: float) -> ToldVibrations:
        """Return what poses tell of the vibrations from which they come.

        Of coordinates of variance L^2, a regression on the d = 2 n ways explains d + L^2 tr(A) / d
        in the mean, in variances of noise, where A is the information on coefficients of the ways.
        What is more than d is never taken for less than its sigma without vibrations. Where poses
        are too few to tell anything, the level is the highest; vibrations that are seen may let
        cables hang loose for a moment.

        Args:
            about: Coefficients about which poses follow in proportion, shape (2 n,).
            errors: There, with `PROBE` more of each way, and with other cables in q ways, of all
                poses, shape (1 + 2 n + q, K, 6).
            cable_probe: By how much cables are others [sigma].
        """
        missed, freedoms = _fast(self.run, -errors[0])
        count, cables = len(self.ways), len(errors) - 1 - len(self.ways)
        if 6 * freedoms < FREEDOMS_MIN * count:
            return self.untold(cables)
        probes = np.concatenate([np.full(count, PROBE), np.full(cables, cable_probe)])
        slopes = _fast(self.run, errors[1:] - errors[0])[0].reshape(len(probes), -1).T / probes
        left, ways = missed, slopes[:, :count]
        for fitted in (0, count):  # vibrations that are seen are no noise
            power = (left.reshape(-1, 2, 3) ** 2).sum(axis=(0, 2))
            sides = np.sqrt(power / (3 * freedoms - 0.5 * fitted))  # of positions, rotations
            sigma = np.tile(np.repeat(sides, 3), len(missed))
            wanted = missed.ravel() / sigma
            change = np.linalg.lstsq(ways / sigma[:, None], wanted, rcond=None)[0]
            left = missed - (ways @ change).reshape(missed.shape)
        scaled, best = slopes / sigma[:, None], about + change
        information = scaled.T @ scaled
        own = information[:count, :count]
        explained, told = float(best @ own @ best), float(np.trace(own)) / count
        chance = float(np.sqrt(2.0 * count))
        strength = max(explained - count, chance)
        level = float(np.sqrt(strength / max(told, TINY)))
        seen = strength > SEEN_SIGMAS * chance and level < 2.0 * SLACK
        return ToldVibrations(
            level=min(level, SLACK if seen else self.highest), information=information,
            pull=scaled.T @ wanted + information[:, :count] @ about,
            scatter=np.repeat(sides, 3), freedoms=freedoms, cables=cables,
        )  # fmt: skip

    def untold(self, cables: int) -> ToldVibrations:
        """Return that poses tell nothing, of q ways in which cables may be others either."""
        size = len(self.ways) + cables
        return ToldVibrations(
            level=self.highest, information=np.zeros((size, size)), pull=np.zeros(size),
            scatter=np.ones(6), freedoms=0, cables=cables,
        )  # fmt: skip

    def shows(self, told: ToldVibrations, errors: Array) -> bool:
        """Say whether poses show what a platform does that vibrates likeliest.

        Poses miss a calm platform by more than that one, by its power if vibrations and it are
        alike; by less by as much if their phases are lost.

        Args:
            told: By these poses.
            errors: Of a calm start and of the likeliest one, of all poses, shape (2, K, 6).
        """
        calm, likeliest = _fast(self.run, errors)[0] / told.scatter
        power = float(((calm - likeliest) ** 2).sum())
        explained = float((calm**2).sum() - (likeliest**2).sum())
        return explained >= SHOWN_SHARE * power

    def cost(self, told: ToldVibrations, along: Array, errors: Array) -> float:
        """Return the cost of coefficients (2 n,) with errors (K, 6) there, as told beside them."""
        left = _fast(self.run, errors)[0] / told.scatter
        return float((left**2).sum()) + told.known(1.0) * float(along @ along)


@dataclass(frozen=True, kw_only=True, eq=False)
class ToldVibrations:
    """What the poses of a run tell of how strongly it starts in each of d ways to vibrate.

    Attributes:
        level: Sigma before of each coordinate of the start; of the coefficients of the d ways it is
            this over the root of d.
        information: On the coefficients, and on q ways in which cables may be others, shape
            (d + q, d + q).
        pull: Information times their estimate from poses alone, cables unchanged, shape (d + q,).
        scatter: Of positions [m] and rotations [rad] beside them, shape (6,).
        freedoms: Of each component of these.
        cables: q.
    """

    level: float
    information: Array
    pull: Array
    scatter: Array
    freedoms: int
    cables: int

    def sigma_points(self) -> Array:
        """Return the likeliest coefficients, and others to both sides that scatter as they may.

        Shape (1 + 2 d, d); the covariance of the others about the likeliest is the posterior one.
        """
        count = len(self.pull) - self.cables
        precision = self.information[:count, :count] + self.known(self.level) * np.eye(count)
        root = np.linalg.inv(np.linalg.cholesky(precision))  # root^T root is the covariance
        best, off = root.T @ (root @ self.pull[:count]), np.sqrt(count) * root
        return np.concatenate([best[None], best + off, best - off])

    @property
    def forgotten(self) -> ToldVibrations:
        """The same where poses tell the level alone."""
        return replace(self, information=0.0 * self.information, pull=0.0 * self.pull)

    def follows(self, before: ToldVibrations) -> bool:
        """Say whether poses still scatter about likeliest vibrations as they did for a short while.

        Args:
            before: What fewer of the poses told.
        """
        if not before.freedoms or not self.freedoms:
            return not before.freedoms
        chance = np.sqrt(f.isf(CHANCE, 3 * self.freedoms, 3 * before.freedoms))
        limit = max(LOST_SCATTER_RATIO, float(chance))
        return bool((self.scatter <= limit * before.scatter).all())

    def known(self, level: float) -> float:
        """Return the information before on each coefficient, at a level."""
        return (len(self.pull) - self.cables) / level**2

    def about(self, along: Array) -> Quadratic:
        """Return the cost of changes of cables, then of coefficients (d,), about some of these.

        At a level of 1, as elongations are known before.
        """
        count = len(along)
        order = np.r_[count : count + self.cables, :count]
        gradient = self.information[:, :count] @ along - self.pull
        gradient[:count] += self.known(1.0) * along
        known = np.concatenate([np.full(count, self.known(1.0)), np.zeros(self.cables)])
        information = self.information + np.diag(known)
        return Quadratic(
            cost=0.0, gradient=gradient[order], information=information[np.ix_(order, order)]
        )

    def step(self, along: Array, damping: float, move: Array) -> Array:
        """Return a damped step (d,) to the likeliest coefficients, beside other cables (q,)."""
        cost, cables = self.about(along), slice(self.cables)
        own = slice(self.cables, None)
        precision = cost.information[own, own]
        damped = precision + damping * np.diag(np.diag(self.information)[: len(along)])
        pull = cost.gradient[own] + cost.information[own, cables] @ move
        return np.asarray(-np.linalg.solve(damped, pull), float)


@dataclass(frozen=True, kw_only=True, eq=False)
class HiddenVibrations:
    """What vibrations that noise hides change of the errors of a run.

    Attributes:
        drift: Of errors, the mean over what vibrations may be, shape (K, 6). Errors are corrected
            by it.
        spread: V in the covariance V V^T of what that may be wrong by, shape (6 K, 2 d); (6 K, 0)
            where nothing is hidden.
        along: Coefficients of the likeliest vibrations, from which a later search begins, shape
            (d,); (0,) where there was none.
    """

    drift: Array
    spread: Array
    along: Array

    @classmethod
    def none(cls, errors: Array) -> HiddenVibrations:
        """Return those of a run with errors (K, 6) that nothing hidden changes."""
        return cls(
            drift=np.zeros_like(errors), spread=np.zeros((errors.size, 0)), along=np.zeros(0)
        )


def _fast(run: FittedRun, errors: Array) -> tuple[Array, int]:
    """Return what no sway makes of errors, as long as vibrations are looked for.

    Args:
        run: With all poses.
        errors: Of these, shape (..., K, 6).

    Returns:
        shape (..., K', 6); and how many freedoms are left of each component.
    """
    time = run.poses.time - run.poses.time[0]
    rows = time <= run.leading + SEEN_WINDOWS * run.window
    span = float(time[rows][-1])
    degree = sway_degree(span, float(run.sway.frequency.max()) / (2.0 * np.pi))
    if rows.sum() <= degree + 1:
        return errors[..., :0, :], 0
    basis = sway_basis(time[rows], span, degree)
    seen = errors[..., rows, :]
    return np.asarray(seen - basis @ (basis.T @ seen)), int(rows.sum()) - degree - 1
