"""The cost of errors of recordings, with all else that is known of the coordinates of a search."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calibration.identification.cross_validation import Folds
from calibration.identification.doubts import Doubts, Judge
from calibration.identification.error_noise import PoseErrorNoise, estimate_noise
from calibration.identification.frequencies import FrequencyTable, KnownFrequencies
from calibration.identification.linearization import Linearization
from calibration.identification.quadratic import Quadratic
from calibration.identification.run_errors import RunErrors
from calibration.identification.search_space import SearchSpace
from carosac_toolkit.base.arrays import Array

# Of few recordings together, each of which is held out once; and of each, as a start that is held
# out altogether is not known.
HELD_OUT_STRETCHES, HELD_OUT_OF_EACH = 8, 2


class FitCost:
    """The cost that a search lowers.

    Attributes:
        known: What is known beside the recordings, about where `about` looked last.
        doubts: What errors have in common there; None: that was not looked at.
        linear: Errors of each run as linear functions; None: slopes are derivatives.
    """

    def __init__(
        self, space: SearchSpace, run_errors: RunErrors, frequencies: FrequencyTable | None
    ) -> None:
        """Take what is known beside the recordings.

        Args:
            space: Coordinates that are searched.
            run_errors: What the recordings miss.
            frequencies: Measured beside the recordings; None: none.
        """
        self._space = space
        self._run_errors = run_errors
        self._frequencies = (
            None
            if frequencies is None
            else KnownFrequencies(table=frequencies, unknowns=space.unknowns)
        )
        self.known = Quadratic(  # frequencies once a step looks at them
            cost=0.0, gradient=np.zeros(len(space.begin)), information=space.prior
        )
        self.doubts: Doubts | None = None
        self.linear: Sequence[Linearization] | None = None

    @property
    def precision(self) -> Array:
        """Information of what is known beside the recordings, shape (p, p)."""
        return self.known.information

    def noise(self, errors: Sequence[Array]) -> PoseErrorNoise:
        """Return the noise of errors of each run (K, 6)."""
        return estimate_noise([errors[k] for k in self._space.kept], apart=self._space.many)

    def judge(self, noise: PoseErrorNoise) -> Judge:
        """Return by which errors count, with noise of each."""
        return Judge(noise=noise, doubts=self.doubts)

    def total(self, at: Array, errors: Sequence[Array], noise: PoseErrorNoise) -> float:
        """Return the cost of errors of all runs at coordinates, with all else that is known."""
        judge = self.judge(noise)
        data = sum(judge.cost(k, errors[k]) for k in self._space.kept)
        if self._frequencies is not None:
            data += self._frequencies.cost(at[: self._space.count])
        return float(data + at @ self._space.prior @ at)

    def with_start(self, k: int, at: Array, errors: Array, noise: PoseErrorNoise) -> float:
        """Return the cost of errors (K, 6) of a run, with what is known of its start."""
        start = at[self._space.start_of(k)]
        return self.judge(noise).cost(k, errors) + float(start @ start)

    def look(
        self, at: Array, errors: Sequence[Array], jacobians: Sequence[Array], noise: PoseErrorNoise
    ) -> None:
        """Find what is known beside the recordings about coordinates, and what errors share.

        Args:
            at: All coordinates.
            errors: Of each run there (K, 6).
            jacobians: By what each depends on (K, 6, p).
            noise: Of the errors.
        """
        self.known = self._known_about(at)
        self.doubts = self._doubted(errors, jacobians, noise)

    def about(
        self, at: Array, errors: Sequence[Array], jacobians: Sequence[Array], noise: PoseErrorNoise
    ) -> tuple[Array, Array]:
        """Look; return the Hessian of half the cost and its gradient, with all else that is known.

        Arguments are those of `look`.
        """
        self.look(at, errors, jacobians, noise)
        information, gradient = self.normal(errors, jacobians, noise)
        return information + self.precision, gradient + self.known.gradient

    def normal(
        self, errors: Sequence[Array], jacobians: Sequence[Array], noise: PoseErrorNoise
    ) -> tuple[Array, Array]:
        """Return the information of the recordings, and half the derivative of their cost."""
        prior, judge = self._space.prior, self.judge(noise)
        information, gradient = np.zeros_like(prior), np.zeros(len(prior))
        for k in self._space.kept:
            own, error = self._space.own[k], errors[k]
            flat = jacobians[k].reshape(-1, len(own))
            information[np.ix_(own, own)] += judge.product(k, error, flat, flat)
            gradient[own] += judge.product(k, error, flat, error.reshape(-1, 1))[:, 0]
        return information, gradient

    def _known_about(self, at: Array) -> Quadratic:
        """Return the cost of what is known beside the recordings, about coordinates."""
        pull, information = np.asarray(self._space.prior @ at), self._space.prior
        cost = float(at @ pull)
        if self._frequencies is not None:
            robot = slice(self._space.count)
            told = self._frequencies.about(at[robot])
            information = information.copy()
            information[robot, robot] += told.information
            pull[robot] += told.gradient
            cost += told.cost
        return Quadratic(cost=cost, gradient=pull, information=information)

    def _doubted(
        self, errors: Sequence[Array], jacobians: Sequence[Array], noise: PoseErrorNoise
    ) -> Doubts | None:
        """Return what errors have in common beside noise; None: that was not looked at.

        Vibrations that noise hides change them, and what linear functions leave out.
        """
        hidden, linear = self._run_errors.hidden, self.linear
        if hidden is None and linear is None:
            return None
        columns = [np.zeros((each.size, 0)) for each in errors]
        for more in (
            [each.spread for each in hidden or ()],
            [each.beyond for each in linear or ()],
        ):
            if more:
                columns = [np.hstack(both) for both in zip(columns, more, strict=True)]
        return self.beside_starts(columns, errors, jacobians, noise)

    def beside_starts(
        self,
        columns: Sequence[Array],
        errors: Sequence[Array],
        jacobians: Sequence[Array],
        noise: PoseErrorNoise,
    ) -> Doubts:
        """Return what the start of each run does not make up for of columns (6 K, d)."""
        return Doubts.beside_starts(
            columns,
            [
                each.reshape(len(own), -1)[:, self._space.count :]
                for each, own in zip(jacobians, columns, strict=True)
            ],
            [noise.weights(each).ravel() for each in errors],
        )

    def marginal(self, information: Array) -> Array:
        """Return what is left for the robot of an information (Schur complement), (k, k)."""
        own, start = slice(self._space.count), slice(self._space.count, None)
        known = (information + self.precision)[start, start]
        cross = information[own, start]
        return np.asarray(information[own, own] - cross @ np.linalg.solve(known, cross.T))

    def run_about(self, k: int, at: Array, judge: Judge, errors: Array, slopes: Array) -> Quadratic:
        """Return the cost of a run by what it depends on, with what is known of its start.

        Args:
            k: Run.
            at: All coordinates.
            judge: By which errors count.
            errors: Of it there, shape (K, 6).
            slopes: Derivatives by what it depends on, shape (K, 6, p); only those of the start, if
                the robot is held.
        """
        cost = _quadratic(k, judge, errors, slopes)
        gradient, information = cost.gradient.copy(), cost.information.copy()
        start = at[self._space.start_of(k)]
        loose = slice(len(gradient) - len(start), None)
        gradient[loose] += start
        information[loose, loose] += np.eye(len(start))
        constant = cost.cost + float(start @ start)
        return Quadratic(cost=constant, gradient=gradient, information=information)

    def folds(
        self, at: Array, errors: Sequence[Array], jacobians: Sequence[Array], judge: Judge
    ) -> Folds:
        """Return the recordings, or stretches of few of them, about coordinates.

        Each of many recordings has a start of its own, which follows.

        Args:
            at: All coordinates.
            errors: Of each run there (K, 6).
            jacobians: By what each depends on (K, 6, p).
            judge: By which errors count.
        """
        space, parts = self._space, list[Quadratic]()
        size = space.count if space.many else len(at)
        total = sum(len(errors[k]) for k in space.kept)
        for k in space.kept:
            own, error, slopes = space.own[k], errors[k], jacobians[k]
            if space.many:
                fold = self.run_about(k, at, judge, error, slopes)
                parts.append(fold.least_beside(space.count))
                continue
            stretches = max(HELD_OUT_OF_EACH, round(HELD_OUT_STRETCHES * len(error) / total))
            stretches = min(stretches, len(error))
            for rows in np.array_split(np.arange(len(error)), stretches):
                fold = _quadratic(k, judge, error[rows], slopes[rows])
                gradient, information = np.zeros(size), np.zeros((size, size))
                gradient[own], information[np.ix_(own, own)] = fold.gradient, fold.information
                parts.append(replace(fold, gradient=gradient, information=information))
        first = slice(size)
        beside = replace(
            self.known,
            gradient=self.known.gradient[first],
            information=self.precision[first, first],
        )
        places = tuple(space.kept) if space.many else tuple(range(len(parts)))
        return Folds(
            parts=parts, known=beside, at=at[first].copy(), lower=space.lower[first],
            judge=judge, places=places,
        )  # fmt: skip


def _quadratic(k: int, judge: Judge, errors: Array, slopes: Array) -> Quadratic:
    """Return the cost of some errors (K, 6) of a run, by what it depends on."""
    flat = slopes.reshape(errors.size, -1)
    return Quadratic(
        cost=judge.cost(k, errors),
        gradient=judge.product(k, errors, flat, errors.reshape(-1, 1))[:, 0],
        information=judge.product(k, errors, flat, flat),
    )
