"""Trajectories from files: a table of times and positions, or a recording."""

from __future__ import annotations

import hashlib
from functools import lru_cache
from math import factorial
from pathlib import Path

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidFile, MissingFile
from carosac_toolkit.recordings.bundled import find_recording, list_recordings
from carosac_toolkit.recordings.csv_file import read_table
from carosac_toolkit.recordings.files import READERS_BY_SUFFIX, load_recording
from carosac_toolkit.recordings.table import FAULTS_SHOWN, Faults
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.trajectories.curves import PiecewisePolynomial
from carosac_toolkit.trajectories.recorded import from_recording
from carosac_toolkit.trajectories.resting import onto_rest
from carosac_toolkit.trajectories.trajectory import Trajectory

PATH_COLUMNS = ("time_s", "position_x_m", "position_y_m", "position_z_m")
LENGTH_COLUMN_STARTS = ("unstrained_length", "cable_length")  # of a recording
SPLINE_DEGREE = 5
ROWS_MIN = 2


def is_path_file(name: str) -> bool:
    """Return True for a file or folder, or a bundled recording; False for a catalogue's name."""
    return (
        name.lower().endswith(tuple(READERS_BY_SUFFIX))
        or "/" in name
        or "\\" in name
        or name in list_recordings()
    )


def path_file(name: str) -> Path:
    """Return the file of a trajectory: the one named, or the only recording of a folder.

    Raises:
        MissingFile: It is not there.
        InvalidFile: A folder that holds no recording, or several.
    """
    path = find_recording(name)
    if not path.exists():
        raise MissingFile(path, "a trajectory is a .csv, or a recording or the folder with one")
    if not path.is_dir():
        return path
    held = sorted(file for file in path.iterdir() if file.suffix.lower() in READERS_BY_SUFFIX)
    if len(held) != 1:
        names = ", ".join(file.name for file in held[:5]) or "none"
        raise InvalidFile(path, [f"recordings: got {names}; allowed: one in a folder, or name it"])
    return held[0]


def path_digest(name: str) -> str | None:
    """Return sixteen hexadecimal digits of a file, or None for a name of the catalogue."""
    if not is_path_file(name):
        return None
    return hashlib.sha256(path_file(name).read_bytes()).hexdigest()[:16]


def from_file(name: str, robot: Robot) -> Trajectory:
    """Follow the positions of a file at its own times, so that speeds are those of the file.

    A CSV table with the columns `PATH_COLUMNS` is interpolated: a quintic spline through every
    row, at rest at the first and the last one. A recording is smoothed, as `from_recording` does;
    without measured poses it is the path of the equilibria on its lengths. With two cables the path
    is moved onto positions at which the robot can rest.

    Args:
        name: The file, the folder with it, or a bundled recording.
        robot: Robot whose equilibria count where a recording has no poses, and whose workspace
            box the path must stay in.

    Raises:
        InvalidFile: All faults of the table or the recording.
        InvalidField: The path leaves the box.
    """
    file = path_file(name)
    return _read(file, path_digest(name) or "", robot).within(robot)


@lru_cache(maxsize=8)
def _read(file: Path, digest: str, robot: Robot) -> Trajectory:
    """Read a trajectory once per file, content and robot."""
    columns = _table(file)
    if columns is None:
        path = from_recording(load_recording(file), robot)
        wanted = Trajectory(name=file.name, curve=path.curve, duration=path.duration)
    else:
        time, position = columns
        curve, duration = _through(time, position), float(time[-1])
        wanted = Trajectory(name=file.name, curve=curve, duration=duration)
    return onto_rest(robot, wanted)


def _table(file: Path) -> tuple[Array, Array] | None:
    """Return times from 0 (N,) [s] and positions (N, 3) [m]; None for a recording."""
    if file.suffix.lower() != ".csv":
        return None
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
    return time - time[0], columns[:, 1:]


def _through(time: Array, position: Array) -> PiecewisePolynomial:
    """Interpolate positions (N, 3) at times from 0 (N,), with both ends at rest."""
    from scipy.interpolate import make_interp_spline

    still = [(order, np.zeros(3)) for order in (1, 2)]  # velocity and acceleration at the ends
    spline = make_interp_spline(time, position, k=SPLINE_DEGREE, bc_type=(still, still))
    powers = range(SPLINE_DEGREE + 1)
    pieces = [spline(time[:-1], nu=power) / factorial(power) for power in powers]
    return PiecewisePolynomial(breaks=time, coefficients=np.stack(pieces, axis=1))
