"""A signal after a shaper whose frequency changes: impulses are set apart by phase."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from baselines.lookahead import interpolated
from baselines.shapers import Shaper, impulses
from carosac_toolkit.base.arrays import Array


class SignalHistory:
    """Past samples of a signal, constant before the first one."""

    def __init__(self) -> None:
        self._at: Array = np.zeros((0, 0))
        self._value: Array = np.zeros((0, 0, 3))

    @property
    def empty(self) -> bool:
        """True before the first sample."""
        return self._at.size == 0

    @property
    def last(self) -> Array:
        """Time or phase of the last sample, shape (B,)."""
        return self._at[:, -1]

    def add(self, at: Array, value: Array, keep: float) -> None:
        """Append a sample, and drop those that lie further back than `keep`.

        Args:
            at: Time or phase, larger than that of the last sample, shape (B,).
            value: Shape (B, 3).
            keep: In the unit of `at`.
        """
        if self.empty:
            self._at, self._value = at[:, None], value[:, None]
            return
        needed: NDArray[np.bool_] = self._at[:, 1:] > (at - keep)[:, None]
        count = int(needed.any(axis=0).sum()) + 1  # one further back, to interpolate from
        self._at = np.concatenate([self._at[:, -count:], at[:, None]], axis=1)
        self._value = np.concatenate([self._value[:, -count:], value[:, None]], axis=1)

    def at(self, where: Array) -> Array:
        """Interpolate values at (B, M) times or phases: (B, M, 3)."""
        return interpolated(where, self._at, self._value)


class ShapedSignal:
    """One shaper for one mode, sample by sample."""

    def __init__(self, shaper: Shaper) -> None:
        self._shaper = shaper
        self._past = SignalHistory()
        self._time: Array = np.zeros(0)
        self._rate: Array = np.zeros(0)

    def next(self, time: Array, value: Array, frequency: Array, damping: Array) -> Array:
        """Take a sample of the signal and return one of the shaped signal.

        Args:
            time: Later than the last one [s], shape (B,).
            value: Of the signal, shape (B, 3).
            frequency: Undamped natural frequency of the mode now [Hz], > 0, shape (B,).
            damping: Its damping ratio, below 1, shape (B,).

        Returns:
            Shape (B, 3).
        """
        times, amplitudes = impulses(self._shaper, frequency, damping)
        rate = np.pi / (times[:, 1] - times[:, 0])  # damped angular frequency [rad/s]
        phase = np.zeros_like(time)
        if not self._past.empty:  # trapezoids
            phase = self._past.last + 0.5 * (rate + self._rate) * (time - self._time)
        back = np.pi * np.arange(times.shape[1])  # [rad]
        self._past.add(phase, value, keep=float(back[-1]))
        self._time, self._rate = time, rate
        values = self._past.at(phase[:, None] - back)
        return np.asarray((amplitudes[..., None] * values).sum(axis=1))
