"""The factor graph: errors of all key frames from all that was measured, with gtsam.

Variables are what changes, at each key frame, and one of what is constant: mass, centre of mass,
the errors of the sensors, and the delay where it is among the errors. Factors are the start, the
dynamics from key frame to key frame, poses, angles and inertial samples, linear in the errors of a
forward pass.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from baselines.dynamic_estimator.filter_state import Errors
from baselines.dynamic_estimator.measurement_models import LinearisedMeasurement
from baselines.smoother.forward_pass import ForwardPass
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import CarosacError

Weights = Mapping[tuple[int, str], float]
WHOLE_RECORDING_S = 1e12
KNOWN_DEVIATION_RATIO = 1e-4  # of the scale of an error: what counts as known


@dataclass(frozen=True, kw_only=True, eq=False)
class GraphSolution:
    """Estimated errors of K key frames.

    Attributes:
        error: Shape (K, size), what is constant as it was when a key frame left the lag.
        covariance: Of what changes, shape (K, c, c), c the number of it.
        constant: Covariance of what is constant, in the end, shape (size - c, size - c).
    """

    error: Array
    covariance: Array
    constant: Array


class ErrorGraph:
    """Graphs of one robot and one start."""

    def __init__(self, errors: Errors, scale: Array, start: Array) -> None:
        """Take the covariance of the start.

        Args:
            errors: Their order; what follows it is constant.
            scale: What errors are measured in, shape (size,).
            start: Covariance of the errors at the start, shape (size, size).
        """
        every = np.arange(len(scale))
        fixed = every >= errors.imu.start
        fixed[errors.mass] = fixed[errors.center] = True
        fixed[errors.heading] = False  # an AHRS may drift
        self.changing, self.constant = every[~fixed], every[fixed]
        self._scale = scale
        self._start = start + np.diag((KNOWN_DEVIATION_RATIO * scale) ** 2)

    def solve(
        self, passed: ForwardPass, time: Array, weight: Weights, lag: float | None
    ) -> GraphSolution:
        """Find the errors.

        Args:
            passed: The forward pass about which they are.
            time: Of its key frames [s], shape (K,).
            weight: Of poses and angles, by key frame and channel.
            lag: [s]; None: all at once.

        Raises:
            CarosacError: The errors are not determined.
        """
        import gtsam

        params = gtsam.ISAM2Params()
        params.setOptimizationParams(gtsam.ISAM2GaussNewtonParams(0.0))
        params.setFactorization("QR")
        longest = float(np.diff(time).max())
        window = WHOLE_RECORDING_S if lag is None else 2.0 * lag + longest
        smoother = gtsam.IncrementalFixedLagSmoother(window, params)
        reader = _SolutionReader(self, len(time))
        ends = [len(time)] if lag is None else _ends(time, lag)
        begin = taken = 0
        try:
            for end in ends:
                self._update(smoother, passed, time, weight, range(begin, end))
                whole = end == len(time)
                upto = end if whole or lag is None else int(
                    np.searchsorted(time, time[end - 1] - lag, side="right")
                )  # fmt: skip
                reader.take(smoother, range(taken, upto), whole)
                begin, taken = end, upto
        except RuntimeError as error:
            first = str(error).strip().splitlines()[0]
            raise CarosacError(f"the smoother could not tell the errors: {first}") from error
        return reader.solution()

    def _update(
        self,
        smoother: Any,
        passed: ForwardPass,
        time: Array,
        weight: Weights,
        new: range,
    ) -> None:
        """Add key frames to the smoother."""
        import gtsam

        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        stamps = {CONSTANT_KEY: float(time[new[-1]])}
        for k in new:
            if k == 0:
                values.insert(CONSTANT_KEY, np.zeros(len(self.constant)))
                graph.push_back(self._first(passed.corrections[0]))
            else:
                link = passed.links[k - 1]
                graph.push_back(self._moves(k, link.carry, link.noise, passed.corrections[k]))
                if link.felt is not None:
                    graph.push_back(self._said(k - 1, link.felt, 1.0))
            for channel, said in passed.said.get(k, {}).items():
                graph.push_back(self._said(k, said, weight.get((k, channel), 1.0)))
            values.insert(_key(k), np.zeros(len(self.changing)))
            stamps[_key(k)] = float(time[k])
        smoother.update(graph, values, stamps)

    def _first(self, correction: Array) -> Any:
        """Build the factor of the start."""
        root = _whitening(self._start)
        return self._factor(0, root, -root @ correction)

    def _moves(self, k: int, carry: Array, noise: Array, correction: Array) -> Any:
        """Build the factor of the dynamics from the key frame before to key frame k."""
        changing, constant = self.changing, self.constant
        root = _whitening(noise[np.ix_(changing, changing)])
        blocks = [
            (_key(k - 1), -root @ carry[np.ix_(changing, changing)] * self._scale[changing]),
            (_key(k), root * self._scale[changing]),
            (CONSTANT_KEY, -root @ carry[np.ix_(changing, constant)] * self._scale[constant]),
        ]
        return _linear(blocks, -root @ correction[changing])

    def _said(self, k: int, measurement: LinearisedMeasurement, weight: float) -> Any:
        """Build the factor of a measurement of key frame k."""
        root = np.sqrt(weight) * _whitening(measurement.noise)
        return self._factor(k, root @ measurement.by, root @ measurement.residual)

    def _factor(self, k: int, by: Array, value: Array) -> Any:
        """Build a factor of key frame k: `by` times its errors is `value`, with unit noise."""
        blocks = [
            (_key(k), by[:, self.changing] * self._scale[self.changing]),
            (CONSTANT_KEY, by[:, self.constant] * self._scale[self.constant]),
        ]
        return _linear(blocks, value)

    def scaled(self, some: NDArray[np.int64]) -> Array:
        """Return the scales of some errors."""
        return np.asarray(self._scale[some])


class _SolutionReader:
    """Collects a solution, key frame by key frame."""

    def __init__(self, graph: ErrorGraph, count: int) -> None:
        self._graph = graph
        changing, constant = graph.changing, graph.constant
        self._error = np.zeros((count, len(changing) + len(constant)))
        self._covariance = np.zeros((count, len(changing), len(changing)))
        self._constant = np.zeros((len(constant), len(constant)))

    def take(self, smoother: Any, keys: range, whole: bool) -> None:
        """Read key frames out of a smoother; what is constant, when that is `whole`."""
        if not keys:
            return
        values = smoother.calculateEstimate()
        changing, constant = self._graph.changing, self._graph.constant
        here, there = self._graph.scaled(changing), self._graph.scaled(constant)
        known = there * values.atVector(CONSTANT_KEY)
        for k in keys:
            self._error[k, changing] = here * values.atVector(_key(k))
            self._error[k, constant] = known
            self._covariance[k] = smoother.marginalCovariance(_key(k)) * np.outer(here, here)
        if whole:
            self._constant = smoother.marginalCovariance(CONSTANT_KEY) * np.outer(there, there)

    def solution(self) -> GraphSolution:
        """Return the collected solution."""
        return GraphSolution(
            error=self._error, covariance=self._covariance, constant=self._constant
        )


CONSTANT_KEY = 0  # key; those of key frames follow


def _key(k: int) -> int:
    return k + 1


def _linear(blocks: list[tuple[int, Array]], value: Array) -> Any:
    """Build a factor of unit noise: the sum of blocks times variables, by key, is `value`."""
    import gtsam

    zero = gtsam.Values()  # without it the factor has no error
    for key, block in blocks:
        zero.insert(key, np.zeros(block.shape[1]))
    unit = gtsam.noiseModel.Unit.Create(len(value))
    flat: list[Any] = [part for block in blocks for part in block]
    factor: Any = gtsam.JacobianFactor
    return gtsam.LinearContainerFactor(factor(*flat, value, unit), zero)


def _ends(time: Array, lag: float) -> list[int]:
    """Return one past the last key frame of each part of a recording, a lag long."""
    count = max(1, int(np.ceil((time[-1] - time[0]) / lag)))
    stops = time[0] + lag * np.arange(1, count)
    inner = np.unique(np.searchsorted(time, stops, side="right"))
    return [int(i) for i in inner if 0 < i < len(time)] + [len(time)]


def _whitening(covariance: Array) -> Array:
    """Return W with W^T W the inverse of a covariance."""
    return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)))
