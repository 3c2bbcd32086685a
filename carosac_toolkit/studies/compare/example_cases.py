"""Example cases: time series of one case of each kind, kept with its row for pictures."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.studies.compare.results import scored, tracked
from carosac_toolkit.studies.run.rows import Row

REST_SPEED_MAX_M_S = 5e-3  # [m/s]: slower references count as rest
REST_DURATION_MIN_S = 0.3  # [s]: shorter ones are the beginning of a motion


@dataclass(frozen=True, kw_only=True, eq=False)
class Example:
    """Time series of one case, S samples.

    Attributes:
        trajectory: Its name.
        seed: Its draw of plant, path and noise.
        diverged: True if the case diverged, so that its errors are no score.
        time: From the start [s], shape (S,).
        reference: Platform origin asked for in W [m], shape (S, 3).
        position: True platform origin in W [m], shape (S, 3).
        belief: Estimated platform origin in W [m], shape (S, 3); None where it was not kept.
    """

    trajectory: str
    seed: int
    diverged: bool
    time: Array
    reference: Array
    position: Array
    belief: Array | None = None

    @property
    def error(self) -> Array:
        """Position minus reference, signed, and its norm [m], shape (S, 4)."""
        return _with_norm(self.position - self.reference)

    @property
    def estimation_error(self) -> Array:
        """Estimate minus position, signed, and its norm [m], shape (S, 4), where it was kept."""
        assert self.belief is not None
        return _with_norm(self.belief - self.position)

    def rests(self) -> list[tuple[float, float]]:
        """Start and end of each rest of the reference [s]."""
        speed = np.linalg.norm(np.diff(self.reference, axis=0), axis=1) / np.diff(self.time)
        resting = np.concatenate([[False], speed < REST_SPEED_MAX_M_S, [False]]).astype(int)
        edges = np.flatnonzero(np.diff(resting))
        spans = [(float(self.time[a]), float(self.time[b])) for a, b in edges.reshape(-1, 2)]
        return [(start, end) for start, end in spans if end - start > REST_DURATION_MIN_S]


def examples_of(rows: Sequence[Row]) -> list[Example]:
    """Return the tracking cases whose time series was kept."""
    return [example for row in tracked(rows) if (example := _example(row)) is not None]


def curves_of(rows: Sequence[Row]) -> list[Example]:
    """Return the tracking cases whose time series was kept, also those that diverged."""
    ran = [row for row in rows if row.get("tracking_rmse_norm_m") is not None]
    return [example for row in ran if (example := _example(row)) is not None]


def estimates_of(rows: Sequence[Row]) -> list[Example]:
    """Return the cases whose estimates were kept, also those that track nothing."""
    examples = (_example(row) for row in scored(rows))
    return [one for one in examples if one is not None and one.belief is not None]


def _with_norm(error: Array) -> Array:
    """Return errors along the axes, shape (S, 3), and their norm, shape (S, 4)."""
    return np.column_stack([error, np.linalg.norm(error, axis=1)])


def _example(row: Row) -> Example | None:
    """Return the time series of a case, or None if it was not kept."""
    if row.get("series") is None:
        return None
    series = json.loads(str(row["series"]))
    if series["position_m"] is None:
        return None
    return Example(
        trajectory=str(row["trajectory"]),
        seed=int(row["seed"] or 0),
        diverged=row["status"] == "diverged",
        time=np.array(series["time_s"]),
        reference=np.array(series["reference_m"]),
        position=np.array(series["position_m"]),
        belief=np.array(series["belief_m"]) if series.get("belief_m") is not None else None,
    )
