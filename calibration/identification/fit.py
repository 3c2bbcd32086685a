"""Gauss-Newton on coordinates of a robot; one batch of worlds gives errors and Jacobian."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from calibration.identification.error_noise import PoseErrorNoise, estimate_noise
from calibration.identification.measured_poses import MeasuredPoses
from calibration.identification.open_loop import OpenLoop, OpenLoopStart, simulate
from calibration.identification.settings import IdentificationSettings
from calibration.identification.sway import FreeSway
from calibration.identification.unknowns import Coordinates
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import CarosacError, InvalidField
from carosac_toolkit.recordings.length_path import LengthPath
from carosac_toolkit.robot.robot import Robot

FINITE_DIFFERENCE_STEP = 0.005  # of the coordinates, for differences
SETTLED_DECREASE = 0.1  # what a step must promise to lower the cost by, which is in squared sigmas
POSE_SHARES = (
    0.15,
    0.4,
    1.0,
)  # of the poses, from the first: later ones would be out of phase at first
STEPS_PER_SHARE = 4  # for each share but the last
NOISE_UPDATES_MAX = 6  # steps after which the noise is no longer estimated anew
SCORE_STRETCH_S = 5.0  # [s]
CORRELATED_AXES = 6.0  # axes that count as one in covariances: one swing shows in all of them
STEP_MAX_SIGMAS = 2.0  # prior sigmas that a coordinate may move in one step
DAMPING_START = 1e-3  # of the Hessian's diagonal, to begin with
DAMPING_TRIES_MAX = 9  # dampings that are tried before a search gives up
ProgressCallback = Callable[[int, float, float], None]


@dataclass(frozen=True, kw_only=True, eq=False)
class CoordinateFit:
    """Coordinates that fit best.

    Attributes:
        coordinates: shape (k,).
        covariance: shape (k, k); the unknown start is taken into account.
        information: Fisher information of the data alone, shape (k, k), less what the unknown start
            takes from it.
        start: Coordinates of the sway at the start, shape (2 m,).
        excess: Factor by which the data count for less than independent innovations [1].
        iterations: Steps taken.
        converged: True if the last step was small.
    """

    coordinates: Array
    covariance: Array
    information: Array
    start: Array
    excess: float
    iterations: int
    converged: bool


class Fitter:
    """The search for the robot that moves as measured."""

    def __init__(
        self,
        unknowns: Coordinates,
        path: LengthPath,
        poses: MeasuredPoses,
        sway: FreeSway,
        settings: IdentificationSettings,
    ) -> None:
        """Take the data.

        Args:
            unknowns: k coordinates.
            path: Readings.
            poses: Measured ones to be fitted.
            sway: Unknown motion at the start, beside the k coordinates.
            settings: Settings of the computation.
        """
        self._unknowns = unknowns
        self._path = path
        self._poses = poses
        self._settings = settings
        self._sway = sway
        self._count = len(unknowns.prior.names)
        loose = len(sway.guess)
        self._names = (*unknowns.prior.names, *sway.names)
        self._sigma = np.concatenate([unknowns.prior.sigma, np.ones(loose)])
        self._lower = np.concatenate([unknowns.lower, np.full(loose, -np.inf)])
        self._precision = block_diag(unknowns.prior.information, np.eye(loose))

    def run(self, report: ProgressCallback) -> CoordinateFit:
        """Search.

        Args:
            report: Called before each step with the number of poses that it looks at, and their
                RMS errors [m] and [rad].

        Raises:
            CarosacError: The robot's simulation fails where the search stands.
        """
        at = np.concatenate([self._unknowns.prior.mean, self._sway.guess])
        whole = self._poses
        for share in POSE_SHARES:
            self._poses = whole.rows(np.arange(round(share * len(whole.time))))
            at, count, settled = self._settle(at, STEPS_PER_SHARE if share < 1.0 else None, report)
        errors, jacobian = self._linearised(at)
        noise = estimate_noise(errors)
        information, _ = self._normal(at, errors, jacobian, noise)
        excess = self._excess(errors, jacobian, noise, information)
        own = slice(self._count)
        inverse = np.linalg.inv(information + self._precision)
        scores = CORRELATED_AXES * excess * information  # as they vary, beside the prior
        root = inverse @ np.linalg.cholesky(scores + self._precision)
        covariance = root @ root.T  # rounding leaves the product of three too asymmetric
        information /= CORRELATED_AXES * excess
        return CoordinateFit(
            coordinates=at[own],
            covariance=np.asarray(covariance[own, own], float),
            information=self._marginal(information),
            start=at[self._count :],
            excess=excess,
            iterations=count,
            converged=settled,
        )

    def _marginal(self, information: Array) -> Array:
        """Return what is left for the robot of an information (Schur complement), (k, k)."""
        own, start = slice(self._count), slice(self._count, None)
        known = (information + self._precision)[start, start]
        cross = information[own, start]
        return np.asarray(information[own, own] - cross @ np.linalg.solve(known, cross.T))

    def _settle(
        self, at: Array, steps: int | None, report: ProgressCallback
    ) -> tuple[Array, int, bool]:
        """Search from somewhere, for some steps or to the end.

        Returns:
            Where it ended, after how many steps, and whether it settled.
        """
        damping, settled = DAMPING_START, False
        for count in range(1, (steps or self._settings.iterations) + 1):
            errors, jacobian = self._linearised(at)
            if count <= NOISE_UPDATES_MAX:
                noise = estimate_noise(errors)
            report(len(errors), *_rms(errors))
            information, gradient = self._normal(at, errors, jacobian, noise)
            hessian = information + self._precision
            settled = self._promise(at, hessian, gradient) <= SETTLED_DECREASE
            if settled and count > NOISE_UPDATES_MAX:
                break
            at, damping = self._search(at, hessian, gradient, noise.cost(errors), noise, damping)
        return at, count, settled

    def _excess(
        self, errors: Array, jacobian: Array, noise: PoseErrorNoise, information: Array
    ) -> float:
        """Return by how much scores of long stretches vary more than independent ones, >= 1."""
        scores = np.einsum("nci,nc->ni", jacobian, noise.weights(errors) * errors)
        length = max(
            1, int(np.searchsorted(self._poses.time, self._poses.time[0] + SCORE_STRETCH_S))
        )
        edges = np.arange(0, len(scores), length)
        sums = np.add.reduceat(scores, edges, axis=0)
        inverse = np.linalg.inv(information + self._precision)
        spread = float(np.einsum("bi,ij,bj->", sums, inverse, sums))
        return max(1.0, spread / float(np.trace(inverse @ information)))

    def _simulated(self, points: Array) -> tuple[OpenLoop, NDArray[np.bool_]]:
        """Simulate robots at coordinates (B, k + 2 m); return motions, and which robots exist."""
        robots: list[Robot] = []
        exists = np.ones(len(points), dtype=np.bool_)
        for k, point in enumerate(points):
            try:
                robots.append(self._unknowns.robot_at(point[: self._count]))
            except InvalidField:
                robots.append(self._unknowns.robot)
                exists[k] = False
        start = OpenLoopStart(sway=self._sway, coordinates=points[:, self._count :])
        motion = simulate(
            robots, self._path, self._poses.time, time_step=self._settings.time_step, start=start
        )
        return motion.seen_by(self._unknowns.robot, robots), exists & ~motion.failed

    def _linearised(self, at: Array) -> tuple[Array, Array]:
        """Return the errors (K, 6) and their Jacobian (K, 6, k + 2 m)."""
        motion, good = self._simulated(
            np.vstack([at, at + FINITE_DIFFERENCE_STEP * np.eye(len(at))])
        )
        if not good.all():
            row = int(np.argmin(good))
            beside = f" with another {self._names[row - 1]}" if row else ""
            raise CarosacError(f"identification: no finite motion of the robot{beside}")
        errors = [
            self._poses.errors(motion.position[:, k], motion.rotation[:, k])
            for k in range(len(at) + 1)
        ]
        return errors[0], np.stack(
            [(error - errors[0]) / FINITE_DIFFERENCE_STEP for error in errors[1:]], axis=2
        )

    def _normal(
        self, at: Array, errors: Array, jacobian: Array, noise: PoseErrorNoise
    ) -> tuple[Array, Array]:
        """Return the information of the data, and the gradient with the prior."""
        weights = noise.weights(errors)
        information = np.einsum("nci,nc,ncj->ij", jacobian, weights, jacobian)
        pull = np.einsum("nci,nc->i", jacobian, weights * errors)
        return information, pull + self._precision @ at

    def _search(
        self,
        at: Array,
        hessian: Array,
        gradient: Array,
        cost: float,
        noise: PoseErrorNoise,
        damping: float,
    ) -> tuple[Array, float]:
        """Search a Levenberg-Marquardt step that lowers the cost; return its end and damping.

        Returns:
            Where it leads, `at` itself where none helps; the damping to begin with next time.
        """
        lowest = cost + float(at @ self._precision @ at)
        for _ in range(DAMPING_TRIES_MAX):
            point = self._stepped(at, hessian, gradient, damping)
            motion, good = self._simulated(point[None])
            errors = self._poses.errors(motion.position[:, 0], motion.rotation[:, 0])
            trial = noise.cost(errors) + float(point @ self._precision @ point)
            if good[0] and trial < lowest:
                return point, max(damping / 8.0, 1e-6)
            damping *= 5.0
        return at, DAMPING_START

    def _free(self, at: Array, gradient: Array) -> NDArray[np.bool_]:
        """Return the coordinates that are not held at their bound."""
        return np.asarray(~((at <= self._lower + 1e-9) & (gradient > 0.0)))

    def _promise(self, at: Array, hessian: Array, gradient: Array) -> float:
        """Return by how much a whole Gauss-Newton step would lower the cost."""
        free = self._free(at, gradient)
        inverse = np.linalg.inv(hessian[np.ix_(free, free)])
        return float(gradient[free] @ inverse @ gradient[free])

    def _stepped(self, at: Array, hessian: Array, gradient: Array, damping: float) -> Array:
        """Return the end of a damped step; coordinates that would leave their bound stay on it."""
        lower, free = self._lower, self._free(at, gradient)
        stiff = hessian + damping * np.diag(np.diag(hessian))
        step = np.zeros(len(at))
        step[free] = -np.linalg.solve(stiff[np.ix_(free, free)], gradient[free])
        longest = float(np.abs(step / self._sigma).max())
        return np.asarray(np.maximum(at + step * min(1.0, STEP_MAX_SIGMAS / longest), lower))


def _rms(errors: Array) -> tuple[float, float]:
    """Return the RMS distance [m] and angle [rad] of errors (K, 6)."""
    power = (errors**2).mean(axis=0)
    return float(np.sqrt(power[:3].sum())), float(np.sqrt(power[3:].sum()))
