"""Maximum a posteriori fit of the parameters: gtsam inside, reweighting against blunders around it.

One error of a measured pose enters all cables of its sample. Each sample is therefore whitened by
the whole covariance of its readings, in which the pose error is marginalised; blunders are left
out by giving a single reading an infinite variance there. All samples are stacked in one factor.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.lengths.model import correction, in_world, predict, tensions, upwards
from calibration.lengths.samples import PosePath, PosesAt
from calibration.lengths.settings import LengthSettings
from calibration.lengths.unknowns import LengthUnknowns
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.physics.cable.straight_line import straight_length
from carosac_toolkit.robot.robot import Robot

Mask = NDArray[np.bool_]
BLUNDER_SIGMAS = 3.7  # standard deviations: farther readings are blunders
CAUCHY_SIGMAS = 2.385  # 95 % efficient on normal noise
SOFT_ROUNDS = 4
ROUNDS_MAX = 25
SETTLED_SIGMAS = 1e-2  # of a standard deviation
BALANCE_NOISE_START_RAD = 1e-3  # [rad] at the start
NOISE_MIN = 1e-4  # [m] and [rad]
LAG_CORRELATION_SIGMAS = 3.0  # standard deviations of a correlation in time that counts


@dataclass(frozen=True, kw_only=True, eq=False)
class LinearReadings:
    """All samples at some values of the parameters.

    Attributes:
        residual: Measured less predicted, shape (S, m).
        jacobian: Of the prediction by the k parameters, (S, m, k).
        by_pose: Of the prediction by an error of the pose, (S, m, 6).
    """

    residual: Array
    jacobian: Array
    by_pose: Array


@dataclass(kw_only=True, eq=False)
class Reweighting:
    """What the reweighting knows.

    Attributes:
        value: Of the parameters, shape (k,).
        weight: Of the readings and of the balance, shape (S, m); 0: left out.
        length_noise: [m].
        plumb_noise: Of the balance [rad].
        inflation: How many samples, following each other, tell as much as one independent one.
    """

    value: Array
    weight: Array
    length_noise: float
    plumb_noise: float = BALANCE_NOISE_START_RAD
    inflation: float = 1.0
    rounds: int = field(default=0)


class LengthProblem:
    """The readings of a recording as functions of the parameters."""

    def __init__(
        self,
        unknowns: LengthUnknowns,
        settings: LengthSettings,
        path: PosePath,
        time: Array,
        reading: Array,
    ) -> None:
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
        self.plumb = unknowns.robot.n < 6
        self._last: tuple[Array, LinearReadings] | None = None
        self._robot: tuple[Array, Robot] | None = None
        self.noise = np.diag([settings.position_noise**2] * 3 + [settings.rotation_noise**2] * 3)

    def freeze(self, value: Array) -> None:
        """Take poses and the effect of sag and stretch as they are at some values."""
        self._last = None
        robot = self.robot_at(value)
        self.delay = float(robot.length_delay or 0.0)
        self._poses = self._path.at(self.time, self.delay)
        self.without_pose: Mask = ~self._poses.valid
        placed = in_world(robot, self._poses, anchored=self.unknowns.anchored)
        safe = np.flatnonzero(placed.valid)
        self._correction = np.full(self.reading.shape, np.nan)
        self.tension = np.full(self.reading.shape, np.nan)
        self._vague = np.zeros(self.reading.shape)  # [m^2]
        if len(safe):
            some = _rows(placed, safe)
            up = upwards(robot, anchored=self.unknowns.anchored)
            self.tension[safe] = tensions(robot, some, up)
            found = correction(robot, some, self.tension[safe])
            self._correction[safe] = found.value
            self._vague[safe] = (self.settings.tension_share * found.by_tension) ** 2
        self.usable: Mask = np.isfinite(self._correction).all(axis=1)
        self._used = np.flatnonzero(self.usable)

    def robot_at(self, value: Array) -> Robot:
        """The robot with these parameters; the last one is kept."""
        if self._robot is None or not np.array_equal(self._robot[0], value):
            self._robot = (value.copy(), self.unknowns.robot_at(value))
        return self._robot[1]

    def placed(self, value: Array) -> PosesAt:
        """Poses of the usable samples in W."""
        some = _rows(self._poses, self._used)
        return in_world(self.robot_at(value), some, anchored=self.unknowns.anchored)

    def direction(self, value: Array) -> Array:
        """Unit vectors along the cables at the usable samples, from exit to anchor, (S, n, 3)."""
        poses = self.placed(value)
        robot = self.robot_at(value)
        return straight_length(robot, poses.position, poses.rotation).direction

    def linear(self, value: Array) -> LinearReadings:
        """Residuals and derivatives of the usable samples; the last answer is kept."""
        if self._last is None or not np.array_equal(self._last[0], value):
            self._last = (value.copy(), self._linear(value))
        return self._last[1]

    def _linear(self, value: Array) -> LinearReadings:
        robot = self.robot_at(value)
        used = self._used
        poses = self.placed(value)
        shift = float(robot.length_delay or 0.0) - self.delay
        found = predict(
            robot, poses, self._correction[used], plumb=self.plumb, anchored=self.unknowns.anchored
        )
        predicted = found.value + shift * (found.by_pose @ poses.twist[..., None])[..., 0]
        measured = np.zeros(predicted.shape)
        measured[:, : robot.n] = self.reading[used]
        return LinearReadings(
            residual=measured - predicted,
            jacobian=found.by_all[:, :, self.unknowns.columns],
            by_pose=found.by_pose,
        )

    def covariance(self, by_pose: Array, state: Reweighting) -> Array:
        """Covariance of each sample as measured, blunders apart, shape (S, m, m)."""
        found = by_pose @ self.noise @ by_pose.swapaxes(1, 2)
        n, own = self.unknowns.robot.n, np.arange(by_pose.shape[1])
        found[:, own, own] += np.where(own < n, state.length_noise, state.plumb_noise) ** 2
        found[:, own[:n], own[:n]] += self._vague[self._used]
        return np.asarray(found)

    def whitening(self, by_pose: Array, state: Reweighting) -> Array:
        """Square roots of the inverse covariances of the weighted samples, shape (S, m, m).

        A weight w makes the variance of a reading of its own, without that of the pose, 1 / w
        times as large.
        """
        root = np.sqrt(state.weight)
        whole = self.covariance(by_pose, state)
        pose = by_pose @ self.noise @ by_pose.swapaxes(1, 2)
        own = np.einsum("sii->si", whole) - np.einsum("sii->si", pose)
        scaled = root[:, :, None] * pose * root[:, None, :]
        diagonal = np.arange(own.shape[1])
        scaled[:, diagonal, diagonal] += own
        lower = np.linalg.cholesky(scaled)
        white = np.linalg.inv(lower) * root[:, None, :]
        return np.asarray(white / np.sqrt(state.inflation))


def fit(problem: LengthProblem, start: Array) -> tuple[Reweighting, Array, LinearReadings]:
    """Fit the parameters.

    Returns:
        The last state, the joint covariance of the parameters (k, k), and the samples there.
    """
    settings = problem.settings
    state = Reweighting(
        value=start.copy(), weight=np.ones(0), length_noise=settings.length_noise or 0.0
    )
    problem.freeze(state.value)
    linear = _start(problem, state)
    covariance = np.zeros((0, 0))
    for state.rounds in range(1, ROUNDS_MAX + 1):
        soft = state.rounds <= SOFT_ROUNDS
        before = state.value
        state.value, covariance = _solve(problem, state, linear)
        problem.freeze(state.value)
        linear = problem.linear(state.value)
        weight = state.weight
        _reweigh(problem, state, linear, soft=soft)
        same = weight.shape == state.weight.shape and ((weight > 0.0) == (state.weight > 0.0)).all()
        step = np.abs(state.value - before) / np.sqrt(np.diag(covariance))
        if not soft and same and step.max() < SETTLED_SIGMAS:
            break
    return state, covariance, linear


def _start(problem: LengthProblem, state: Reweighting) -> LinearReadings:
    """Offsets as the medians say, everything else as it was; noise as the spread says."""
    n = problem.unknowns.robot.n
    linear = problem.linear(state.value)
    offsets = problem.unknowns.index("length_offset")
    if len(offsets) == n:
        state.value[offsets] += np.median(linear.residual[:, :n], axis=0)
        linear = problem.linear(state.value)
    state.weight = np.ones(linear.residual.shape)
    _reweigh(problem, state, linear, soft=True)
    return linear


def _reweigh(
    problem: LengthProblem, state: Reweighting, linear: LinearReadings, *, soft: bool
) -> None:
    """Weights and noise from the residuals: Cauchy's first, then in or out."""
    n = problem.unknowns.robot.n
    if state.weight.shape != linear.residual.shape:
        state.weight = np.ones(linear.residual.shape)
    if soft:
        for columns, name in _groups(problem):
            spread = 1.4826 * float(np.median(np.abs(linear.residual[:, columns])))
            if name == "plumb_noise" or problem.settings.length_noise is None:
                setattr(state, name, max(spread, NOISE_MIN))
    covariance = problem.covariance(linear.by_pose, state)
    ratio = np.abs(linear.residual) / np.sqrt(np.einsum("sii->si", covariance))
    if ratio.shape[1] > n:  # the balance of a sample counts as a whole
        ratio[:, n:] = np.linalg.norm(ratio[:, n:], axis=1, keepdims=True) / np.sqrt(6 - n)
    if soft:
        state.weight = 1.0 / (1.0 + (ratio / CAUCHY_SIGMAS) ** 2)
        return
    state.weight = (ratio <= BLUNDER_SIGMAS).astype(float)
    _estimate_noise(problem, state, linear)


def _groups(problem: LengthProblem) -> list[tuple[slice, str]]:
    """Columns with a noise of their own."""
    n = problem.unknowns.robot.n
    return [(slice(0, n), "length_noise")] + (
        [(slice(n, 6), "plumb_noise")] if problem.plumb else []
    )


def _estimate_noise(problem: LengthProblem, state: Reweighting, linear: LinearReadings) -> None:
    """Noise that makes the weighted residuals as large as they should be."""
    count = int((state.weight > 0.0).sum())
    share = count / max(count - len(state.value), 1)
    kept = state.inflation
    state.inflation = 1.0
    white = problem.whitening(linear.by_pose, state)
    inverse = white.swapaxes(1, 2) @ white
    pulled = np.einsum("sij,sj->si", inverse, linear.residual)
    for columns, name in _groups(problem):
        if name == "length_noise" and problem.settings.length_noise is not None:
            continue
        asked = float((pulled[:, columns] ** 2).sum())
        given = float(np.einsum("sii->si", inverse)[:, columns].sum())
        if given > 0.0:
            value = getattr(state, name) * np.sqrt(share * asked / given)
            setattr(state, name, max(value, NOISE_MIN))
    state.inflation = kept if kept > 1.0 else 1.0
    state.inflation = _inflation(problem, state, linear)


def _inflation(problem: LengthProblem, state: Reweighting, linear: LinearReadings) -> float:
    """By how much the residuals' correlation in time spoils the information, >= 1."""
    n = problem.unknowns.robot.n
    kept = np.where(state.weight[:, :n] > 0.0, linear.residual[:, :n], np.nan)
    kept = kept[:, np.isfinite(kept).any(axis=0)]
    kept = kept - np.nanmean(kept, axis=0)
    pairs = kept[1:] * kept[:-1]
    known = np.isfinite(pairs)
    if known.sum() < 20:
        return 1.0
    lag = float(np.nansum(pairs) / known.sum() / np.nanmean(kept**2))
    if lag < LAG_CORRELATION_SIGMAS / np.sqrt(known.sum()):
        return 1.0
    lag = min(lag, 0.98)
    return (1.0 + lag) / (1.0 - lag)


def _solve(
    problem: LengthProblem, state: Reweighting, linear: LinearReadings
) -> tuple[Array, Array]:
    """One weighted least-squares problem, by Levenberg-Marquardt; value and covariance."""
    import gtsam

    unknowns = problem.unknowns
    key = gtsam.symbol("x", 0)
    white = problem.whitening(linear.by_pose, state)
    rows = white.shape[0] * white.shape[1]

    def error(_: Any, values: Any, jacobians: Any) -> Array:
        now = problem.linear(values.atVector(key))
        if jacobians is not None:
            stacked = (white @ now.jacobian).reshape(rows, -1)
            jacobians[0] = np.asfortranarray(-stacked)
        return np.asarray((white @ now.residual[..., None]).reshape(rows))

    graph = gtsam.NonlinearFactorGraph()
    graph.add(gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(rows), [key], error))
    prior = gtsam.noiseModel.Gaussian.Covariance(unknowns.covariance)
    graph.add(gtsam.PriorFactorVector(key, unknowns.start, prior))
    values = gtsam.Values()
    values.insert(key, state.value)
    limits = gtsam.LevenbergMarquardtParams()
    limits.setMaxIterations(1)  # linearised anew around it
    limits.setRelativeErrorTol(1e-6)
    best = gtsam.LevenbergMarquardtOptimizer(graph, values, limits).optimize()
    covariance = gtsam.Marginals(graph, best).marginalCovariance(key)
    return np.asarray(best.atVector(key)), np.asarray(covariance)


def _rows(poses: PosesAt, rows: NDArray[np.int64]) -> PosesAt:
    """Some of the poses."""
    return PosesAt(
        position=poses.position[rows],
        rotation=poses.rotation[rows],
        twist=poses.twist[rows],
        valid=poses.valid[rows],
    )
