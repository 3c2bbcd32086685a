"""Rows of a reference at given times ahead of now."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

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
        row: The row before each, K of them; a slice, which takes no copy, where they are in turn.
        next_row: The row after each.
        share: Of the way to the next row, shape (K, 1).
        last_row: The last one that is looked at.
        between: Whether any lies between rows.
    """

    row: NDArray[np.intp] | slice
    next_row: NDArray[np.intp] | slice
    share: Array
    last_row: int
    between: bool

    @classmethod
    def of(cls, ahead: Sequence[float] | Array) -> ReferenceRows:
        """Split times in periods into rows and shares."""
        row = np.floor(np.array(ahead) + ROW_TOLERANCE).astype(np.intp)
        share: Array = np.array(ahead, dtype=np.float64)[:, None] - row[:, None]
        return cls(
            row=_in_turn(row), next_row=_in_turn(row + 1), share=share,
            last_row=int(row.max(initial=0)) + 1, between=bool((share > ROW_TOLERANCE).any()),
        )  # fmt: skip

    def rows(self, values: Array, size: int) -> Array:
        """Interpolate values of B or one for all, (1 or B, N, 3), at these times: (B, K, 3)."""
        rows: Array = values[:, self.row]
        if self.between:
            rows = (1.0 - self.share) * rows + self.share * values[:, self.next_row]
        return rows if len(rows) == size else np.broadcast_to(rows, (size, *rows.shape[1:]))


def _in_turn(rows: NDArray[np.intp]) -> NDArray[np.intp] | slice:
    """Return consecutive rows as a slice, and others as they are."""
    if len(rows) == 0:
        return slice(0)
    return slice(int(rows[0]), int(rows[-1]) + 1) if (np.diff(rows) == 1).all() else rows
