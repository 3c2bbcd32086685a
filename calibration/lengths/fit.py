"""Robust maximum a posteriori fit of the parameters, one linearisation for each reweighting.

An error of a measured pose enters all cables of its sample. It is an unknown of its own, with the
noise of the poses as its prior. gtsam eliminates these unknowns, sample by sample, and leaves the
parameters with their covariance. Around it, readings are weighted anew until none changes sides:
by Cauchy's weights at first, then in or out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.lengths.model import correction, in_world, predict, tensions, upwards
from calibration.lengths.pose_path import PosePath, PosesAt
from calibration.lengths.settings import LengthSettings
from calibration.lengths.unknowns import LengthUnknowns
from calibration.linear_samples import LinearSamples
from calibration.robust import MAD_FACTOR, cauchy
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.physics.cable.straight_line import straight_length
from carosac_toolkit.robot.robot import Robot

Mask = NDArray[np.bool_]
BLUNDER_SIGMAS = 3.7  # farther readings are blunders
CAUCHY_SIGMAS = 2.385  # 95 % efficient on normal noise
SOFT_ROUNDS = 4
ROUNDS_MAX = 25
SETTLED_SIGMAS = 1e-2
BALANCE_NOISE_START_RAD = 1e-3
TENSION_SHARE = 0.05  # of a tension that is unknown, as from the mass: its effect on sag is noise
NOISE_MIN = 1e-4  # [m] and [rad]
LAG_CORRELATION_SIGMAS = 3.0  # of a correlation in time that counts
LAG_PAIRS_MIN = 20  # fewer pairs of samples tell no correlation


@dataclass(kw_only=True, eq=False)
class Reweighting:
    """The state of the fit, changed in place from round to round.

    Attributes:
        value: Of the parameters, shape (k,).
        covariance: Of the parameters, shape (k, k).
        linear: All usable samples at these values; an own unknown is the error of the pose.
        weight: Of the readings and of the balance, shape (S, m); 0: left out.
        length_noise: [m].
        balance_noise: [rad].
        inflation: Number of successive samples that tell as much as one independent sample.
        rounds: Of reweighting.
    """

    value: Array
    covariance: Array
    linear: LinearSamples
    weight: Array
    length_noise: float
    balance_noise: float = BALANCE_NOISE_START_RAD
    inflation: float = 1.0
    rounds: int = 0


class LengthProblem:
    """The readings of a recording as functions of the parameters."""

    def __init__(
        self, unknowns: LengthUnknowns, settings: LengthSettings, path: PosePath, time: Array,
        reading: Array,
    ) -> None:  # fmt: skip
        """Set up.

        Args:
            unknowns: The parameters.
            settings: Noise.
            path: The measured poses.
            time: Of the readings [s], shape (S,).
            reading: [m], shape (S, n).
        """
        self.unknowns, self.settings = unknowns, settings
        self.time, self.reading, self._path = time, reading, path
        self.with_balance = unknowns.robot.n < 6
        self.noise = np.diag([settings.position_noise**2] * 3 + [settings.rotation_noise**2] * 3)

    def freeze(self, value: Array) -> None:
        """Take poses and the effect of sag and stretch as they are at some values."""
        robot = self.unknowns.robot_at(value)
        self.delay = float(robot.length_delay or 0.0)
        self._poses = self._path.at(self.time, self.delay)
        self.without_pose: Mask = ~self._poses.valid
        placed = in_world(robot, self._poses, anchored=self.unknowns.anchored)
        valid = np.flatnonzero(placed.valid)
        self._correction = np.full(self.reading.shape, np.nan)
        self._sag_variance = np.zeros(self.reading.shape)  # [m^2]
        if len(valid):
            poses = _rows(placed, valid)
            tension = tensions(robot, poses, upwards(robot, anchored=self.unknowns.anchored))
            sag = correction(robot, poses, tension)
            self._correction[valid] = sag.value
            self._sag_variance[valid] = (TENSION_SHARE * sag.by_tension) ** 2
        self.usable: Mask = np.isfinite(self._correction).all(axis=1)
        self._used = np.flatnonzero(self.usable)

    def placed(self, robot: Robot) -> PosesAt:
        """Return the poses of the usable samples in W of a robot."""
        return in_world(robot, _rows(self._poses, self._used), anchored=self.unknowns.anchored)

    def direction(self, value: Array) -> Array:
        """Return unit vectors from exit to anchor points at the usable samples, (S, n, 3)."""
        robot = self.unknowns.robot_at(value)
        poses = self.placed(robot)
        return straight_length(robot, poses.position, poses.rotation).direction

    def linear(self, value: Array) -> LinearSamples:
        """Return residuals and derivatives of the usable samples."""
        robot = self.unknowns.robot_at(value)
        poses = self.placed(robot)
        predicted = predict(
            robot, poses, self._correction[self._used], with_balance=self.with_balance,
            anchored=self.unknowns.anchored,
        )  # fmt: skip
        shift = float(robot.length_delay or 0.0) - self.delay
        residual = -predicted.value - shift * (predicted.by_pose @ poses.twist[..., None])[..., 0]
        residual[:, : robot.n] += self.reading[self._used]
        return LinearSamples(
            residual=residual,
            by_shared=-predicted.by_all[:, :, self.unknowns.columns],
            by_own=-predicted.by_pose,
        )

    def variance(self, state: Reweighting) -> Array:
        """Return the variance of each reading beside that of its pose, blunders apart, (S, m)."""
        n = self.unknowns.robot.n
        variance = np.full(state.linear.residual.shape, state.balance_noise**2)
        variance[:, :n] = state.length_noise**2 + self._sag_variance[self._used]
        return variance

    def deviation(self, state: Reweighting) -> Array:
        """Return residuals in standard deviations, those of the poses included, shape (S, m)."""
        by_pose = state.linear.by_own
        pose = np.einsum("smi,ij,smj->sm", by_pose, self.noise, by_pose)
        return np.asarray(state.linear.residual / np.sqrt(pose + self.variance(state)))

    def precision(self, state: Reweighting) -> Array:
        """Return the inverse covariances of the weighted samples, shape (S, m, m).

        A weight w makes the variance of a reading, beside that of its pose, 1 / w times as large.
        """
        root = np.sqrt(state.weight)
        by_pose = root[:, :, None] * state.linear.by_own
        covariance = by_pose @ self.noise @ by_pose.swapaxes(1, 2)
        own = np.arange(root.shape[1])
        covariance[:, own, own] += self.variance(state)
        inverse = np.linalg.inv(covariance)
        return np.asarray(root[:, :, None] * inverse * root[:, None, :] / state.inflation)

    def information(self, state: Reweighting) -> Array:
        """Return the Fisher information of the weighted samples, without priors, (k, k)."""
        jacobian = state.linear.by_shared
        return np.asarray((jacobian.swapaxes(1, 2) @ self.precision(state) @ jacobian).sum(axis=0))


def fit(problem: LengthProblem) -> Reweighting:
    """Fit the parameters; the last round says where."""
    state = _start(problem)
    for state.rounds in range(1, ROUNDS_MAX + 1):
        soft = state.rounds <= SOFT_ROUNDS
        before, weight = state.value, state.weight
        state.value, state.covariance = _solve(problem, state)
        problem.freeze(state.value)
        state.linear = problem.linear(state.value)
        _reweigh(problem, state, soft=soft)
        same = weight.shape == state.weight.shape and ((weight > 0.0) == (state.weight > 0.0)).all()
        step = np.abs(state.value - before) / np.sqrt(np.diag(state.covariance))
        if not soft and same and step.max() < SETTLED_SIGMAS:
            break
    return state


def _start(problem: LengthProblem) -> Reweighting:
    """Start with offsets as the medians say, all else as it was, and noise as the spread says."""
    prior, n = problem.unknowns.prior, problem.unknowns.robot.n
    value = prior.mean.copy()
    problem.freeze(value)
    linear = problem.linear(value)
    offsets = prior.rows("length_offset")
    if len(offsets) == n:
        value[offsets] += np.median(linear.residual[:, :n], axis=0)
        linear = problem.linear(value)
    state = Reweighting(
        value=value, covariance=prior.covariance, linear=linear,
        weight=np.ones(linear.residual.shape), length_noise=problem.settings.length_noise or 0.0,
    )  # fmt: skip
    _reweigh(problem, state, soft=True)
    return state


def _reweigh(problem: LengthProblem, state: Reweighting, *, soft: bool) -> None:
    """Set weights and noise by the residuals: by Cauchy's weights, or in or out."""
    n, residual = problem.unknowns.robot.n, state.linear.residual
    if soft:
        for columns, name in _estimated_noise(problem):
            spread = MAD_FACTOR * float(np.median(np.abs(residual[:, columns])))
            setattr(state, name, max(spread, NOISE_MIN))
    ratio = np.abs(problem.deviation(state))
    if ratio.shape[1] > n:  # the balance of a sample counts as a whole
        ratio[:, n:] = np.linalg.norm(ratio[:, n:], axis=1, keepdims=True) / np.sqrt(6 - n)
    if soft:
        state.weight = cauchy(ratio**2, CAUCHY_SIGMAS**2)[0]
        return
    state.weight = (ratio <= BLUNDER_SIGMAS).astype(float)
    _estimate_noise(problem, state)
    state.inflation = _inflation(problem, state)


def _estimated_noise(problem: LengthProblem) -> list[tuple[slice, str]]:
    """Return columns of the residuals whose noise is estimated, with the name of that noise."""
    n = problem.unknowns.robot.n
    groups = [(slice(0, n), "length_noise")] if problem.settings.length_noise is None else []
    return groups + ([(slice(n, 6), "balance_noise")] if problem.with_balance else [])


def _estimate_noise(problem: LengthProblem, state: Reweighting) -> None:
    """Make the weighted residuals as large as their noise says (Helmert)."""
    count = int((state.weight > 0.0).sum())
    share = count / max(count - len(state.value), 1)
    state.inflation = 1.0
    precision = problem.precision(state)
    pulled = np.einsum("sij,sj->si", precision, state.linear.residual)
    for columns, name in _estimated_noise(problem):
        square = float((pulled[:, columns] ** 2).sum())
        expected = float(np.einsum("sii->si", precision)[:, columns].sum())
        if expected > 0.0:
            noise = getattr(state, name) * np.sqrt(share * square / expected)
            setattr(state, name, max(noise, NOISE_MIN))


def _inflation(problem: LengthProblem, state: Reweighting) -> float:
    """Return by how much the residuals' correlation in time spoils the information, >= 1."""
    n = problem.unknowns.robot.n
    kept = np.where(state.weight[:, :n] > 0.0, state.linear.residual[:, :n], np.nan)
    kept = kept[:, np.isfinite(kept).any(axis=0)]
    kept = kept - np.nanmean(kept, axis=0)
    pairs = kept[1:] * kept[:-1]
    count = int(np.isfinite(pairs).sum())
    if count < LAG_PAIRS_MIN:
        return 1.0
    lag = float(np.nansum(pairs) / count / np.nanmean(kept**2))
    if lag < LAG_CORRELATION_SIGMAS / np.sqrt(count):
        return 1.0
    lag = min(lag, 0.98)
    return (1.0 + lag) / (1.0 - lag)


def _solve(problem: LengthProblem, state: Reweighting) -> tuple[Array, Array]:
    """Solve the linearised problem by a factor graph; return parameters and covariance.

    Each sample has one factor on the parameters and on the error of its pose.
    """
    import gtsam

    prior, linear, parameters = problem.unknowns.prior, state.linear, gtsam.symbol("x", 0)
    weight = np.sqrt(state.weight / problem.variance(state) / state.inflation)
    residual = weight * linear.residual
    by_shared, by_pose = weight[..., None] * linear.by_shared, weight[..., None] * linear.by_own
    root = np.linalg.cholesky(prior.information).T
    pose = np.diag(1.0 / np.sqrt(state.inflation * np.diag(problem.noise)))
    rows = {size: gtsam.noiseModel.Unit.Create(size) for size in (6, residual.shape[1], len(root))}
    graph = gtsam.GaussianFactorGraph()
    step = root @ (prior.mean - state.value)
    graph.add(gtsam.JacobianFactor(parameters, root, step, rows[len(root)]))
    for k, missed in enumerate(residual):
        error = gtsam.symbol("e", k)
        graph.add(gtsam.JacobianFactor(error, pose, np.zeros(6), rows[6]))
        graph.add(
            gtsam.JacobianFactor(
                parameters, by_shared[k], error, by_pose[k], -missed, rows[len(missed)]
            )
        )
    tree = graph.eliminateMultifrontal()
    change = tree.optimize().at(parameters)
    return state.value + change, np.asarray(tree.marginalCovariance(parameters))


def _rows(poses: PosesAt, rows: NDArray[np.int64]) -> PosesAt:
    """Return some of the poses."""
    return PosesAt(
        position=poses.position[rows],
        rotation=poses.rotation[rows],
        twist=poses.twist[rows],
        valid=poses.valid[rows],
    )
