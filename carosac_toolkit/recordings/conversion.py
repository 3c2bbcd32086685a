"""From a recording to a table with its document, and back."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField, InvalidFile
from carosac_toolkit.base.file_limits import check_recording
from carosac_toolkit.loop.values import Imu, Stamped
from carosac_toolkit.recordings.cells import Cells
from carosac_toolkit.recordings.columns import (
    CABLE_COLUMNS,
    CHANNEL_UNITS,
    FIXED_COLUMNS,
    QUATERNION_COLUMNS,
    TIME_COLUMN,
    cables,
    channel_columns,
    name_faults,
)
from carosac_toolkit.recordings.metadata import RecordingMetadata
from carosac_toolkit.recordings.poses import PoseSamples
from carosac_toolkit.recordings.recording import Recording
from carosac_toolkit.recordings.table import Faults, Mask, Table

BLOCK_ROWS = 2**16  # that are written at once
RECORDING_SCHEMA = "carosac-recording/1"


def row_times(recording: Recording) -> Array:
    """Return the time of each row of the table, the union of all time stamps [s], (rows,)."""
    return np.unique(np.concatenate(list(recording.channel_times.values())))


def check_size(recording: Recording, path: Path) -> None:
    """Refuse a recording that would not be read again from a file.

    Raises:
        InvalidFile: It is too large.
    """
    rows = len(row_times(recording))
    samples = {
        channel: (len(stamps), len(channel_columns(channel, recording.n)))
        for channel, stamps in recording.channel_times.items()
    }
    columns = 1 + sum(columns for _, columns in samples.values())
    cells = rows + sum(count * columns for count, columns in samples.values())
    check_recording(path, rows, columns, cells)


def to_blocks(recording: Recording, time: Array) -> Iterator[dict[str, tuple[Array, Mask]]]:
    """Lay all channels out on their common rows, some thousand rows at once.

    Args:
        recording: The recording.
        time: As `row_times` returns them.

    Yields:
        Values, 0 where a cell is empty, and which cells are empty, by column.
    """
    for start in range(0, len(time), BLOCK_ROWS):
        part = time[start : start + BLOCK_ROWS]
        block = {TIME_COLUMN: (part, np.zeros(len(part), dtype=np.bool_))}
        for channel, stamps in recording.channel_times.items():
            first = np.searchsorted(stamps, part[0])
            last = np.searchsorted(stamps, part[-1], side="right")
            rows = np.searchsorted(part, stamps[first:last])
            samples = _channel_values(recording, channel, slice(first, last))
            empty = np.ones(len(part), dtype=np.bool_)
            empty[rows] = False
            for j, name in enumerate(channel_columns(channel, recording.n)):
                values = np.zeros(len(part))
                values[rows] = samples[:, j]
                block[name] = values, empty
        yield block


def to_document(recording: Recording, rows: int) -> dict[str, Any]:
    """Return the JSON document that goes with the table."""
    points = recording.exit_points
    return {
        "schema": RECORDING_SCHEMA,
        "rows": rows,
        "metadata": recording.metadata.to_dict(),
        "exit_points_m": None if points is None else points.tolist(),
        "units": CHANNEL_UNITS,
        "rates_hz": dict(recording.rates),
    }


def from_table(table: Table, document: Mapping[str, Any] | None, path: Path) -> Recording:
    """Read a recording out of a table.

    Args:
        table: With column names as in the file.
        document: Its JSON document, or None for a table that has none.
        path: The file, for messages and as the source of a table without document.

    Raises:
        InvalidFile: With all faults that were found.
    """
    faults = Faults()
    faults.add(name_faults(table.names))
    faults.add(_document_faults(document, table.rows))
    if not table.rows:
        faults.add(["there is no row of data"])
    faults.check(path)
    columns = Cells(table, faults, path)
    time = columns.time()
    n = cables(columns.written)
    channels = {}
    for channel in (*CABLE_COLUMNS, *FIXED_COLUMNS):
        if channel_columns(channel, n)[0] in columns.written:
            filled, values = columns.samples(channel_columns(channel, n))
            if channel in QUATERNION_COLUMNS:
                columns.check_quaternions(channel, filled, values)
            if len(values):
                channels[channel] = _frozen(time[filled]), values
    points = columns.exit_points(n)
    faults.check(path)
    return _assemble(channels, document or {}, path, points)


def _assemble(
    channels: dict[str, tuple[Array, Array]],
    document: Mapping[str, Any],
    path: Path,
    measured_points: Array | None,
) -> Recording:
    """Build the recording from channels without faults, which go as they are used."""
    if "unstrained_length" not in channels:
        raise InvalidFile(path, ["the length columns are empty"])
    time, lengths = channels.pop("unstrained_length")
    poses = imu = None
    if "poses" in channels:
        t, v = channels.pop("poses")
        poses = PoseSamples(time=t, position=_frozen(v[:, :3]), quaternion=_frozen(v[:, 3:]))
    if "imu" in channels:
        t, v = channels.pop("imu")
        imu = Imu(time=t, angular_rate=_frozen(v[:, :3]), specific_force=_frozen(v[:, 3:]))
    stamped = {c: Stamped(time=t, value=_frozen(v)) for c, (t, v) in channels.items()}
    try:
        points = document.get("exit_points_m")
        if points is None:
            points = measured_points
        metadata = RecordingMetadata(source=path.name)
        if document:
            metadata = RecordingMetadata.from_dict(document.get("metadata", {}))
        return Recording(
            time=time, unstrained_length=_frozen(lengths), poses=poses, imu=imu,
            exit_points=points, metadata=metadata, **stamped,
        )  # fmt: skip
    except InvalidField as error:
        raise InvalidFile(path, [str(error)]) from error


def _channel_values(recording: Recording, channel: str, part: slice) -> Array:
    """Return the columns of a channel side by side, in a part of its samples."""
    if channel == "unstrained_length":
        return recording.unstrained_length[part]
    if channel == "poses" and recording.poses is not None:
        poses = recording.poses
        return np.concatenate([poses.position[part], poses.quaternion[part]], axis=1)
    if channel == "imu" and recording.imu is not None:
        imu = recording.imu
        return np.concatenate([imu.angular_rate[part], imu.specific_force[part]], axis=1)
    stamped: Stamped = getattr(recording, channel)
    return stamped.value[part]


def _frozen(array: Array) -> Array:
    """Return an array that owns its values, read-only, so that values need not copy it again."""
    array = np.ascontiguousarray(array) if array.base is None else array.copy()
    array.setflags(write=False)
    return array


def _document_faults(document: Mapping[str, Any] | None, rows: int) -> list[str]:
    """Describe a document of another schema, or of a table that was cut."""
    if document is None:
        return []
    schema, written = document.get("schema"), document.get("rows")
    if schema != RECORDING_SCHEMA:
        return [f"schema: got {schema!r}; allowed: {RECORDING_SCHEMA!r}"]
    if written is not None and written != rows:
        return [f"the file is truncated: {rows} of {written} rows are there"]
    return []
