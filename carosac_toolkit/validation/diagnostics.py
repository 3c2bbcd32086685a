"""Diagnosis of an error: a delay, sway after the moves, or sag."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.validation.scores import SCORE_AXES, by_axis

AXIS_SPEED_MIN_M_S = 0.02  # [m/s]: slower motion of an axis says nothing about a delay
SWAY_FREQUENCY_MAX_HZ = 5.0  # [Hz]
EXPLAINED_SHARE_MIN = 0.6  # share of the swing at rest that one frequency must explain


@dataclass(frozen=True, kw_only=True, eq=False)
class Delay:
    """Least-squares fit of the position error to the measured velocity, per axis x, y, z.

    A model that runs ahead of the measured poses by a time tau errs by tau times the velocity:
    positive means that poses are late, or lengths early. NaN where an axis hardly moves.

    Attributes:
        seconds: Apparent delay of the poses [s], shape (3,).
        deviation: Standard deviation of that, as if the rest were white noise [s], shape (3,).
        explained: Share of the error's variance that it explains, shape (3,).
    """

    seconds: Array
    deviation: Array
    explained: Array

    def data(self) -> dict[str, Any]:
        """Return the numbers, ready for JSON."""
        return {
            "delay_s": by_axis(self.seconds),
            "delay_deviation_s": by_axis(self.deviation),
            "delay_explained": by_axis(self.explained),
        }


@dataclass(frozen=True, kw_only=True)
class RestSway:
    """Sway of the error while the winches rest.

    Attributes:
        axis: The axis of W that swings most, ``x``, ``y`` or ``z``.
        frequency: Common to all rests [Hz].
        amplitude: Root mean square over the rests of the fitted amplitudes [m].
        explained: Share of the variance at rest, means removed, that it explains (adjusted for
            the number of parameters).
    """

    axis: str
    frequency: float
    amplitude: float
    explained: float

    @property
    def clear(self) -> bool:
        """True if one frequency explains most of it."""
        return self.explained >= EXPLAINED_SHARE_MIN

    def data(self) -> dict[str, Any]:
        """Return the numbers, ready for JSON."""
        return {
            "axis": self.axis,
            "frequency_Hz": self.frequency,
            "period_s": 1.0 / self.frequency,
            "amplitude_m": self.amplitude,
            "explained": self.explained,
            "clear": self.clear,
        }


def find_delay(error: Array, velocity: Array) -> Delay:
    """Regress model minus measured position [m] on the measured velocity [m/s], both (S, 3)."""
    fit = np.full((3, 3), np.nan)
    for axis in range(3):
        if len(error) < 4 or velocity[:, axis].std() < AXIS_SPEED_MIN_M_S:
            continue
        v = velocity[:, axis] - velocity[:, axis].mean()
        e = error[:, axis] - error[:, axis].mean()
        delay = float(v @ e / (v @ v))
        left = e - delay * v
        deviation = np.sqrt(left @ left / (len(e) - 2) / (v @ v))
        share = 1.0 - (left @ left) / (e @ e) if e @ e > 0.0 else 0.0
        fit[:, axis] = delay, deviation, share
    return Delay(seconds=fit[0], deviation=fit[1], explained=fit[2])


def find_sway(time: Array, error: Array, rests: Sequence[tuple[int, int]]) -> RestSway | None:
    """Fit one frequency to all rests, each with its own mean, amplitude and phase.

    Args:
        time: [s], shape (S,).
        error: Position error [m], shape (S, 3).
        rests: First and one past the last sample of each rest.

    Returns:
        The swing of the axis with the largest amplitude, or None where the rests are too short
        to tell.
    """
    parts = [(a, b) for a, b in rests if b - a >= 6]
    if not parts or sum(b - a - 3 for a, b in parts) < 6:
        return None
    spans = np.array([time[b - 1] - time[a] for a, b in parts])
    step = float(np.median(np.diff(time)))
    lowest, highest = 0.75 / float(np.median(spans)), min(SWAY_FREQUENCY_MAX_HZ, 0.4 / step)
    if highest <= lowest:
        return None
    step = 0.05 / float(spans.max())
    grid = np.arange(lowest, highest, step)
    left = np.array([_swing(time, error, parts, frequency)[0] for frequency in grid])
    best = grid[np.argmin(left, axis=0)]
    axis = int(np.argmax([_swing(time, error, parts, f)[1][k] for k, f in enumerate(best)]))
    fine = best[axis] + step * np.linspace(-1.0, 1.0, 41)
    residual, amplitude = np.swapaxes([_swing(time, error, parts, f) for f in fine], 0, 1)
    chosen = int(np.argmin(residual[:, axis]))
    total = sum(float(((e := error[a:b, axis]) - e.mean()) @ (e - e.mean())) for a, b in parts)
    if total <= 0.0:
        return None
    count = sum(b - a for a, b in parts)
    ratio = (count - len(parts)) / (count - 3 * len(parts))
    return RestSway(
        axis=SCORE_AXES[axis],
        frequency=float(fine[chosen]),
        amplitude=float(amplitude[chosen, axis]),
        explained=float(1.0 - residual[chosen, axis] / total * ratio),
    )


def _swing(
    time: Array, error: Array, parts: Sequence[tuple[int, int]], frequency: float
) -> tuple[Array, Array]:
    """Return the residual sum of squares [m^2] and the RMS amplitude [m] per axis, each (3,)."""
    left, square = np.zeros(3), np.zeros(3)
    for first, end in parts:
        phase = 2.0 * np.pi * frequency * (time[first:end] - time[first])
        basis = np.column_stack([np.ones(end - first), np.cos(phase), np.sin(phase)])
        weights = np.linalg.lstsq(basis, error[first:end], rcond=None)[0]
        left += ((error[first:end] - basis @ weights) ** 2).sum(axis=0)
        square += weights[1] ** 2 + weights[2] ** 2
    return left, np.sqrt(square / len(parts))


def rest_frequencies(robot: Robot, length: Array, rests: Sequence[tuple[int, int]]) -> Array | None:
    """Return natural frequencies [Hz] by statics at the rests, medians, slowest first, (6,).

    Args:
        robot: Robot description, n cables.
        length: Unstrained lengths [m], shape (N, n).
        rests: First and one past the last sample of each rest.

    Returns:
        None where the robot has no stable equilibrium at any of the rests.
    """
    from carosac_toolkit.physics.rest.modes import natural_frequencies
    from carosac_toolkit.physics.rest.statics import forward_kinematics

    if not rests:
        return None
    means = np.array([length[a:b].mean(axis=0) for a, b in rests])
    equilibria = forward_kinematics(robot, means)
    good = equilibria.converged & equilibria.stable
    if not good.any():
        return None
    equilibria = forward_kinematics(robot, means[good])
    return np.asarray(np.median(natural_frequencies(robot, equilibria), axis=0))
