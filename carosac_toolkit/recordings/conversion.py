"""From a recording to a table with its document, and back."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField, InvalidFile
from carosac_toolkit.loop.values import Imu, Stamped
from carosac_toolkit.recordings.columns import (
    CABLE_COLUMNS,
    CHANNEL_UNITS,
    FIXED_COLUMNS,
    TIME_COLUMN,
    cables,
    canonical,
    channel_columns,
    exit_point_columns,
    name_faults,
)
from carosac_toolkit.recordings.metadata import RecordingMetadata
from carosac_toolkit.recordings.poses import UNIT_NORM_TOLERANCE, PoseSamples
from carosac_toolkit.recordings.recording import STAMPED_CHANNELS, Recording
from carosac_toolkit.recordings.table import Table, shortened

RECORDING_SCHEMA = "carosac-recording/1"


def to_table(recording: Recording) -> Table:
    """Lay all channels out on the union of their time stamps."""
    time = np.unique(np.concatenate(list(recording.channel_times.values())))
    columns = {TIME_COLUMN: time}
    empty = {TIME_COLUMN: np.zeros(len(time), dtype=np.bool_)}
    for channel, stamps in recording.channel_times.items():
        rows = np.searchsorted(time, stamps)
        values = _channel_values(recording, channel)
        for j, name in enumerate(channel_columns(channel, recording.n)):
            columns[name] = np.zeros(len(time))
            columns[name][rows] = values[:, j]
            empty[name] = np.ones(len(time), dtype=np.bool_)
            empty[name][rows] = False
    return Table(columns=columns, empty=empty)


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
    written = list(table.columns)
    names = [canonical(name) for name in written]
    faults = name_faults(written) + _document_faults(document, table.rows)
    if not table.rows:
        faults.append("there is no row of data")
    if faults:
        raise InvalidFile(path, shortened(faults))
    table = Table(
        columns=dict(zip(names, table.columns.values(), strict=True)),
        empty=dict(zip(names, table.empty.values(), strict=True)),
        lines=table.lines,
        written=dict(zip(names, written, strict=True)),
    )
    n = cables(names)
    present = [
        c for c in (*CABLE_COLUMNS, *FIXED_COLUMNS) if channel_columns(c, n)[0] in table.columns
    ]
    faults = _time_faults(table)
    for channel in present:
        faults += _cell_faults(table, channel_columns(channel, n))
    if "poses" in present and not faults:
        faults = _quaternion_faults(table)
    if faults:
        raise InvalidFile(path, shortened(faults))
    return _assemble(table, document or {}, path, n, present)


def _assemble(
    table: Table, document: Mapping[str, Any], path: Path, n: int, present: list[str]
) -> Recording:
    """Build the recording from a table without faults."""
    channels = {c: _samples(table, channel_columns(c, n)) for c in present}
    channels = {c: (time, value) for c, (time, value) in channels.items() if len(time)}
    if "unstrained_length" not in channels:
        raise InvalidFile(path, ["the length columns are empty"])
    time, lengths = channels["unstrained_length"]
    stamped = {
        c: Stamped(time=t, value=v) for c, (t, v) in channels.items() if c in STAMPED_CHANNELS
    }
    poses = imu = None
    if "poses" in channels:
        t, v = channels["poses"]
        poses = PoseSamples(time=t, position=v[:, :3], quaternion=v[:, 3:])
    if "imu" in channels:
        t, v = channels["imu"]
        imu = Imu(time=t, angular_rate=v[:, :3], specific_force=v[:, 3:])
    try:
        points = document.get("exit_points_m")
        if points is None:
            points = _exit_points(table, n)
        metadata = RecordingMetadata(source=path.name)
        if document:
            metadata = RecordingMetadata.from_dict(document.get("metadata", {}))
        return Recording(
            time=time, unstrained_length=lengths, poses=poses, imu=imu,
            exit_points=points, metadata=metadata, **stamped,
        )  # fmt: skip
    except InvalidField as error:
        raise InvalidFile(path, [str(error)]) from error


def _channel_values(recording: Recording, channel: str) -> Array:
    """Return the columns of a channel side by side."""
    if channel == "unstrained_length":
        return recording.unstrained_length
    if channel == "poses" and recording.poses is not None:
        return np.concatenate([recording.poses.position, recording.poses.quaternion], axis=1)
    if channel == "imu" and recording.imu is not None:
        return np.concatenate([recording.imu.angular_rate, recording.imu.specific_force], axis=1)
    stamped: Stamped = getattr(recording, channel)
    return stamped.value


def _samples(table: Table, names: tuple[str, ...]) -> tuple[Array, Array]:
    """Return time (K,) and values (K, columns) of the rows where a channel has a sample."""
    keep = ~table.empty[names[0]]
    return table.columns[TIME_COLUMN][keep], np.stack(
        [table.columns[c][keep] for c in names], axis=1
    )


def _exit_points(table: Table, n: int) -> Array | None:
    """Return the medians of measured exit points, shape (n, 3), or None."""
    names = exit_point_columns(n)
    if names[0] not in table.columns:
        return None
    columns = [table.columns[name][~table.empty[name]] for name in names]
    if min(len(column) for column in columns) == 0:
        return None
    return np.array([np.median(column) for column in columns]).reshape(n, 3)


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


def _time_faults(table: Table) -> list[str]:
    """Describe time stamps that are empty, not finite or do not increase."""
    time, empty = table.columns[TIME_COLUMN], table.empty[TIME_COLUMN]
    bad = empty | ~np.isfinite(time)
    faults = [
        f"{table.row_name(int(i))}, column {TIME_COLUMN!r}: "
        f"got {'nothing' if empty[i] else time[i]}; allowed: a finite time"
        for i in np.flatnonzero(bad)
    ]
    if faults:
        return faults
    return [
        f"{table.row_name(int(i) + 1)}, column {TIME_COLUMN!r}: "
        f"got {time[i + 1]}; allowed: > {time[i]}, the time of the row before"
        for i in np.flatnonzero(np.diff(time) <= 0)
    ]


def _cell_faults(table: Table, names: tuple[str, ...]) -> list[str]:
    """Describe cells that are not finite, or empty while their channel has a sample."""
    empty = np.stack([table.empty[name] for name in names], axis=1)
    values = np.stack([table.columns[name] for name in names], axis=1)
    torn = empty & ~empty.all(axis=1, keepdims=True)
    bad = torn | (~empty & ~np.isfinite(values))
    return [
        f"{table.row_name(int(row))}, column {table.written[names[j]]!r}: got "
        f"{'nothing' if torn[row, j] else values[row, j]}; allowed: a finite number"
        for row, j in np.argwhere(bad)
    ]


def _quaternion_faults(table: Table) -> list[str]:
    """Describe quaternions that are no rotation."""
    names = FIXED_COLUMNS["poses"][3:]
    norm = np.linalg.norm(np.stack([table.columns[name] for name in names], axis=1), axis=1)
    bad = ~table.empty[names[0]] & ~(np.abs(norm - 1.0) <= UNIT_NORM_TOLERANCE)
    return [
        f"{table.row_name(int(row))}, columns 'quaternion_w' to 'quaternion_z': got norm "
        f"{norm[row]:.6g}; allowed: within {UNIT_NORM_TOLERANCE:g} of 1"
        for row in np.flatnonzero(bad)
    ]
