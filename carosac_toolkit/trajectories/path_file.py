"""Trajectories from files: a table of times and positions, or a recording."""

from __future__ import annotations

import hashlib
from functools import lru_cache
from pathlib import Path

from carosac_toolkit.base.errors import InvalidField, InvalidFile, MissingFile
from carosac_toolkit.recordings.bundled import find_recording, list_recordings
from carosac_toolkit.recordings.files import READERS_BY_SUFFIX, load_recording, neighbour
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.trajectories.path_table import PathTable, read_path
from carosac_toolkit.trajectories.recorded import from_recording
from carosac_toolkit.trajectories.resting import onto_rest
from carosac_toolkit.trajectories.trajectory import Trajectory


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
        near = neighbour(path)
        hint = "a trajectory is a .csv, or a recording or the folder with one"
        raise MissingFile(path, f"{hint}; {near}" if near else hint)
    if not path.is_dir():
        return path
    held = sorted(file for file in path.iterdir() if file.suffix.lower() in READERS_BY_SUFFIX)
    if len(held) != 1:
        names = ", ".join(file.name for file in held[:5]) or "none"
        raise InvalidFile(path, [f"recordings: got {names}; allowed: one in a folder, or name it"])
    return held[0]


def check_suffix(name: str) -> None:
    """Refuse a name with a suffix that no file of a trajectory has.

    Raises:
        MissingFile: There is no such file.
        InvalidFile: There is, of another kind.
    """
    path = Path(name)
    if not path.suffix or is_path_file(name):
        return
    suffixes = ", ".join(READERS_BY_SUFFIX)
    if not path.exists():
        near = neighbour(path)
        hint = f"a trajectory is a file with suffix {suffixes}"
        raise MissingFile(path, f"{hint}; {near}" if near else hint)
    raise InvalidFile(path, [f"suffix: got {path.suffix!r}; allowed: {suffixes}"])


def path_digest(name: str) -> str | None:
    """Return sixteen hexadecimal digits of a file, or None for a name of the catalogue."""
    if not is_path_file(name):
        return None
    return hashlib.sha256(path_file(name).read_bytes()).hexdigest()[:16]


def from_file(name: str, robot: Robot) -> Trajectory:
    """Follow the positions of a file at its own times, so that speeds are those of the file.

    A CSV table with the columns `PATH_COLUMNS` is interpolated: quintic pieces through every row,
    at rest at the first and the last one. A recording is smoothed, as `from_recording` does;
    without measured poses it is the path of the equilibria on its lengths. With two cables the path
    is moved onto positions at which the robot can rest.

    Args:
        name: The file, the folder with it, or a bundled recording.
        robot: Robot whose equilibria count where a recording has no poses, and whose workspace
            box the path must stay in.

    Raises:
        InvalidFile: All faults of the table or the recording.
        InvalidField: The path leaves the box; names the row that does, or the two rows between
            which it does.
    """
    file, digest = path_file(name), path_digest(name) or ""
    path, table = _read(file, digest, robot), _table(file, digest)
    leaving = path.leaving(robot)
    if leaving is not None:
        row = None if table is None or path.moved else table.row_outside(robot)
        if row is not None:
            raise InvalidField(f"{file.name}: {row.field}", row.value, row.allowed)
        rows = "" if table is None else f", {table.lines_at(leaving.time)}"
        raise InvalidField(f"{leaving.field}{rows}", leaving.value, leaving.allowed)
    return path


def departure_from_rows(name: str) -> str | None:
    """Say how far a path from a table goes from the straight lines between its rows.

    Returns:
        A sentence, or None up to `DEPARTURE_RATIO` of the size of the path, and for what is no
        table.
    """
    if not is_path_file(name):
        return None
    file = path_file(name)
    table = _table(file, path_digest(name) or "")
    return None if table is None else table.departure(file.name)


@lru_cache(maxsize=8)
def _read(file: Path, digest: str, robot: Robot) -> Trajectory:
    """Read a trajectory once per file, content and robot."""
    table = _table(file, digest)
    if table is None:
        path = from_recording(load_recording(file), robot)
        wanted = Trajectory(name=file.name, curve=path.curve, duration=path.duration)
    else:
        duration = float(table.time[-1])
        wanted = Trajectory(name=file.name, curve=table.curve, duration=duration)
    return onto_rest(robot, wanted)


@lru_cache(maxsize=8)
def _table(file: Path, digest: str) -> PathTable | None:
    """Read a table once per file and content; None for a recording."""
    return read_path(file) if file.suffix.lower() == ".csv" else None
