"""Trajectories one after the other, with rests, as one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from carosac_toolkit import trajectories
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.loop.values import Reference
from carosac_toolkit.trajectories import Trajectory

START_TOLERANCE_M = 1e-3  # a trajectory that starts this close needs no approach


class Course:
    """Sequence of trajectories with a rest before each.

    Attributes:
        duration: Duration of all [s].
        moved: How far a trajectory was moved onto positions of rest, at most [m].
    """

    def __init__(self, parts: Sequence[Trajectory], rest: float) -> None:
        """Chain trajectories, each starting where the one before ends; `rest` [s] > 0."""
        self._parts = tuple(parts)
        self._rest = rest
        lengths = [rest + part.duration for part in parts]
        self._starts = np.concatenate([[0.0], np.cumsum(lengths)[:-1]]) + rest
        self.duration = float(sum(lengths))
        self.moved = max(part.moved for part in self._parts)

    def window(self, time: float, horizon: float, period: float) -> Reference:
        """Return the reference from `time` on; see `Trajectory.window`."""
        rows = 1 + int(np.floor(horizon / period + 1e-9))
        when = time + period * np.arange(rows)
        part = np.clip(np.searchsorted(self._starts - self._rest, when, side="right") - 1, 0, None)
        values: dict[str, Array] = {
            name: np.zeros((1, rows, 3)) for name in ("position", "velocity", "acceleration")
        }
        for k in np.unique(part):
            mask = part == k
            samples = self._parts[k].sample(when[mask] - self._starts[k])
            for name, value in values.items():
                value[0, mask] = getattr(samples, name)
        return Reference(time=np.asarray(when[None], dtype=float), **values)


def with_approach(path: Trajectory, start: Array, *, rest: float, speed_max: float,
                  acceleration_max: float) -> Course:  # fmt: skip
    """Return a straight approach from `start` [m], shape (3,), followed by the trajectory."""
    begin = path.sample(np.zeros(1)).position[0]
    parts = [path]
    if np.linalg.norm(begin - start) > START_TOLERANCE_M:
        limits = {"speed_max": speed_max, "acceleration_max": acceleration_max}
        parts.insert(0, trajectories.line(start, begin, **limits))
    return Course(parts, rest)
