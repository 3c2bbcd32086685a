"""Samples of each channel from the cells of a table, and what is wrong with them."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.file_limits import check_recording
from carosac_toolkit.recordings.columns import (
    FIXED_COLUMNS,
    QUATERNION_COLUMNS,
    TIME_COLUMN,
    canonical,
    exit_point_columns,
)
from carosac_toolkit.recordings.poses import UNIT_NORM_TOLERANCE
from carosac_toolkit.recordings.table import FAULTS_SHOWN, Column, Faults, Mask, Table

OUT_OF_ORDER_NAMED_MAX = 3  # times; more are a file that is not sorted, or of several runs
Cell = tuple[int, int, Any]  # row, index of the column, content


class Cells:
    """Cells of a table by canonical column.

    Attributes:
        written: How the file spells each column.
    """

    def __init__(self, table: Table, faults: Faults, path: Path) -> None:
        """Note faults of cells in `faults`; refuse a file with too many cells."""
        self.written = {canonical(name): name for name in table.names}
        self._table = table
        self._faults = faults
        self._path = path
        self._cells = 0

    def time(self) -> Array:
        """Return all time stamps [s], shape (rows,): finite and increasing, or there is a fault."""
        values, filled = self._take(TIME_COLUMN)
        self._count(len(filled))
        time = np.full(len(filled), np.nan)
        time[filled] = values
        bad = np.flatnonzero(~np.isfinite(time))
        self._note(((i, time[i] if filled[i] else "nothing", "a finite time") for i in bad), bad)
        if not len(bad):
            self._check_order(time)
        return time

    def _check_order(self, time: Array) -> None:
        """Note times that do not increase; many of them are one fault."""
        bad = np.flatnonzero(np.diff(time) <= 0) + 1
        if len(bad) <= OUT_OF_ORDER_NAMED_MAX:
            order = ((i, time[i], f"> {time[i - 1]}, the time of the row before") for i in bad)
            self._note(order, bad)
            return
        self._faults.add([
            f"column {self.written[TIME_COLUMN]!r}: got {len(bad)} of {len(time)} times that are "
            f"not above the one before, the first in {self._table.row_name(int(bad[0]))}; allowed: "
            "rows sorted by time, of one run"
        ])  # fmt: skip

    def samples(self, names: tuple[str, ...]) -> tuple[Mask, Array]:
        """Return the rows in which a channel has a sample, and its samples, shape (K, columns).

        A cell that is not finite is a fault, and one that is empty beside others that are not.
        """
        value, filled = self._take(names[0])
        self._count(len(value) * len(names))
        samples = np.empty((len(value), len(names)))
        masks, any_filled = [np.packbits(filled)], filled
        bad: list[Cell] = []
        count = 0
        for j, name in enumerate(names):
            if j:
                value, mask = self._take(name)
                masks.append(np.packbits(mask))
                any_filled = any_filled | mask
            else:
                mask = filled
            if len(value) == len(samples):  # if not, rows are torn, and nothing is returned
                samples[:, j] = value
            wrong = np.flatnonzero(~np.isfinite(value))
            count += len(wrong)
            if len(wrong):
                rows = np.flatnonzero(mask)[wrong[:FAULTS_SHOWN]]
                bad += [(int(row), j, value[k]) for row, k in zip(rows, wrong, strict=False)]
        whole = np.packbits(any_filled)
        for j, bits in enumerate(masks):
            torn = np.flatnonzero(np.unpackbits(whole & ~bits, count=len(filled)))
            count += len(torn)
            bad += [(int(row), j, "nothing") for row in torn[:FAULTS_SHOWN]]
        texts = [
            f"{self._table.row_name(row)}, column {self.written[names[j]]!r}: got {got}; "
            "allowed: a finite number"
            for row, j, got in sorted(bad, key=lambda cell: cell[:2])
        ]
        self._faults.add(texts, count)
        return filled, samples

    def check_quaternions(self, channel: str, filled: Mask, samples: Array) -> None:
        """Note quaternions of a channel that are no rotation, unless there are other faults."""
        if self._faults:
            return
        columns = QUATERNION_COLUMNS[channel]
        norm = np.linalg.norm(samples[:, columns], axis=1)
        bad = np.flatnonzero(~(np.abs(norm - 1.0) <= UNIT_NORM_TOLERANCE))
        rows = np.flatnonzero(filled)
        first, *_, last = FIXED_COLUMNS[channel][columns]
        texts = (
            f"{self._table.row_name(int(rows[k]))}, columns {first!r} to {last!r}: got norm "
            f"{norm[k]:.6g}; allowed: within {UNIT_NORM_TOLERANCE:g} of 1"
            for k in bad[:FAULTS_SHOWN]
        )
        self._faults.add(texts, len(bad))

    def exit_points(self, n: int) -> Array | None:
        """Return the medians of measured exit points, shape (n, 3), or None."""
        names = exit_point_columns(n)
        if names[0] not in self.written:
            return None
        columns = [self._take(name)[0] for name in names]
        if min(len(column) for column in columns) == 0:
            return None
        return np.array([np.median(column) for column in columns]).reshape(n, 3)

    def _take(self, name: str) -> Column:
        return self._table.take(self.written[name])

    def _count(self, cells: int) -> None:
        """Refuse more cells than a recording may have, before there is memory for them."""
        self._cells += cells
        check_recording(self._path, 0, 0, self._cells)

    def _note(self, cells: Iterable[tuple[Any, Any, str]], bad: NDArray[np.intp]) -> None:
        """Note the first faults of time stamps: row, content, what is allowed."""
        texts = (
            f"{self._table.row_name(int(i))}, column {TIME_COLUMN!r}: got {got}; allowed: {allowed}"
            for i, got, allowed in islice(cells, FAULTS_SHOWN)
        )
        self._faults.add(texts, len(bad))
