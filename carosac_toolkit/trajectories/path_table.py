"""Table of times and positions in a CSV file."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField, InvalidFile
from carosac_toolkit.base.numbers import plain
from carosac_toolkit.recordings.csv_file import read_table
from carosac_toolkit.recordings.table import FAULTS_SHOWN, Faults
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.trajectories.curves import PiecewisePolynomial
from carosac_toolkit.trajectories.row_curve import farthest_from_chords, path_size, through_rows
from carosac_toolkit.trajectories.trajectory import BOX_MARGIN_M

PATH_COLUMNS = ("time_s", "position_x_m", "position_y_m", "position_z_m")
LENGTH_COLUMN_STARTS = ("unstrained_length", "cable_length")  # of a recording
ROWS_MIN = 2
DEPARTURE_RATIO = 0.01  # of the size of the path: up to there nobody is told
OTHER_UNIT_RATIO = 20.0  # of a coordinate to the largest one of the box: likely not in metres
METRES_PER_UNIT = {"mm": 1e-3, "cm": 1e-2}  # units that positions may be in by mistake
ROW_TIME_TOLERANCE = 1e-9  # of the duration: a time this near to that of a row is on it


@dataclass(frozen=True, kw_only=True, eq=False)
class PathTable:
    """Rows of a path.

    Attributes:
        time: From 0, rising [s], shape (N,).
        position: In W [m], shape (N, 3).
        lines: Line of the file that each row stands on, shape (N,).
    """

    time: Array
    position: Array
    lines: NDArray[np.int_]

    @cached_property
    def curve(self) -> PiecewisePolynomial:
        """The curve through the rows, see `through_rows`."""
        return through_rows(self.time, self.position)

    def lines_at(self, time: float) -> str:
        """Name the line of the file at a time [s], or the two lines that it is between."""
        near = int(np.argmin(np.abs(self.time - time)))
        if abs(self.time[near] - time) <= ROW_TIME_TOLERANCE * self.time[-1]:
            return f"on line {self.lines[near]}"
        after = int(np.searchsorted(self.time, time))
        return f"between lines {self.lines[after - 1]} and {self.lines[after]}"

    def row_outside(self, robot: Robot) -> InvalidField | None:
        """Return an error for the first row outside of a robot's workspace box; None without one.

        Coordinates far outside may be in mm or cm, and the error asks.
        """
        low, high = robot.workspace_min, robot.workspace_max
        outside = _outside(self.position, robot)
        if not outside.any():
            return None
        k, axis = (int(i) for i in np.argwhere(outside)[0])
        reach = float(np.abs([low, high]).max())
        far = np.abs(self.position).max() > OTHER_UNIT_RATIO * reach
        fitting = [
            unit
            for unit, size in METRES_PER_UNIT.items()
            if not _outside(size * self.position, robot).any()
        ]
        units = " or ".join(fitting or METRES_PER_UNIT)
        allowed = f"{low[axis]:g} m to {high[axis]:g} m, the box of {robot.name!r}"
        return InvalidField(
            f"line {self.lines[k]}, column {PATH_COLUMNS[1 + axis]!r}",
            f"{self.position[k, axis]:g} m",
            f"{allowed}; are the positions in {units}?" if far else allowed,
        )

    def departure(self, name: str) -> str | None:
        """Say how far the curve goes from the straight lines between the rows, where it is much.

        Args:
            name: Name of the path in the sentence.
        """
        distance, k = farthest_from_chords(self.curve)
        size = path_size(self.position)
        if distance <= DEPARTURE_RATIO * size:
            return None
        return (
            f"{name}: between lines {self.lines[k]} and {self.lines[k + 1]} the path goes up to "
            f"{plain(distance, 3)} m from the straight line, {100 * distance / size:.0f} % of the "
            "size of the path. Add rows where it has to be straight."
        )


def _outside(position: Array, robot: Robot) -> NDArray[np.bool_]:
    """Return which coordinates in W [m] are outside of a robot's workspace box, shape (N, 3)."""
    low, high = robot.workspace_min - BOX_MARGIN_M, robot.workspace_max + BOX_MARGIN_M
    outside: NDArray[np.bool_] = (position < low) | (position > high)
    return outside


def read_path(file: Path) -> PathTable | None:
    """Read times and positions of a CSV file; None for a recording.

    Raises:
        InvalidFile: All faults of the table.
    """
    table, document = read_table(file)
    if document is not None or any(name.startswith(LENGTH_COLUMN_STARTS) for name in table.names):
        return None
    faults = Faults()
    missing = [name for name in PATH_COLUMNS if name not in table.names]
    faults.add(f"column {name!r} is missing" for name in missing)
    faults.add(
        f"column {name!r}: allowed: {', '.join(PATH_COLUMNS)}; remove or rename it"
        for name in table.names
        if name not in PATH_COLUMNS
    )
    faults.check(file)
    columns = np.full((table.rows, len(PATH_COLUMNS)), np.nan)
    lines = np.asarray(table.lines)
    for k, name in enumerate(PATH_COLUMNS):
        values, filled = table.take(name)
        columns[filled, k] = values
        bad = np.flatnonzero(~np.isfinite(columns[:, k]))
        faults.add(
            (
                f"line {lines[i]}, column {name!r}: got "
                f"{columns[i, k] if filled[i] else 'nothing'}; allowed: a finite number"
                for i in bad[:FAULTS_SHOWN]
            ),
            len(bad),
        )
    faults.check(file)
    if len(columns) < ROWS_MIN:
        raise InvalidFile(file, [f"got {len(columns)} rows; allowed: {ROWS_MIN} or more"])
    time = columns[:, 0]
    back = np.flatnonzero(np.diff(time) <= 0.0) + 1
    faults.add(
        (
            f"line {lines[i]}, column 'time_s': got {time[i]:g} after {time[i - 1]:g}; allowed: "
            "rising times"
            for i in back[:FAULTS_SHOWN]
        ),
        len(back),
    )
    faults.check(file)
    return PathTable(time=time - time[0], position=columns[:, 1:], lines=lines)
