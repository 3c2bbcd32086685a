"""Rows of a reference at given times ahead of now."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.loop.values import Reference

ROW_TOLERANCE = 1e-9  # [rows] that are none


def require_rows(reference: Reference, horizon: float, period: float) -> None:
    """Refuse a reference that ends before a horizon [s], with a row for each period [s].

    Raises:
        InvalidField: It does.
    """
    rows = round(horizon / period) + 1
    if reference.time.shape[1] < rows:
        allowed = f"at least {rows}, those of the horizon of {horizon:g} s"
        raise InvalidField("reference", f"{reference.time.shape[1]} rows", allowed)


@dataclass(frozen=True, kw_only=True, eq=False)
class ReferenceRows:
    """Times ahead of now, in rows of a reference.

    Attributes:
        pick: Consecutive rows, which take no copy; None where times lie between rows, or rows
            are skipped.
        weights: Of the rows up to the last one at each of K times, shape (K, last_row + 1).
        last_row: The last one that is looked at.
    """

    pick: slice | None
    weights: Array
    last_row: int

    @classmethod
    def of(cls, ahead: Sequence[float] | Array) -> ReferenceRows:
        """Take times ahead of now, in periods."""
        times = np.array(ahead, dtype=np.float64)
        row = np.floor(times + ROW_TOLERANCE).astype(np.intp)
        share = times - row
        last = int(row.max(initial=0)) + 1
        weights = np.zeros((len(times), last + 1))
        weights[np.arange(len(times)), row] = 1.0 - share
        weights[np.arange(len(times)), row + 1] = share
        in_turn = bool((np.diff(row) == 1).all() and (share <= ROW_TOLERANCE).all())
        first = int(row[0]) if len(row) else 0
        pick = slice(first, first + len(row)) if in_turn else None
        return cls(pick=pick, weights=weights, last_row=last)

    def rows(self, values: Array, size: int) -> Array:
        """Interpolate values of B or one for all, (1 or B, N, 3), at these times: (B, K, 3)."""
        if self.pick is not None:
            rows: Array = values[:, self.pick]
        else:
            rows = self.weights @ values[:, : self.last_row + 1]
        return rows if len(rows) == size else np.broadcast_to(rows, (size, *rows.shape[1:]))
