"""A recording that survives the process: rows of JSON, each written at once.

The first row identifies the file. Every other row is complete, or it is the last one: the reader
drops a truncated row and says so. ``kill -9`` costs no row that was written, a power failure those
since the last ``fsync`` (once a second). An existing file is never overwritten.

A disk may block every call here; the guard calls it from a thread that nobody waits for
(`carosac_toolkit.safety.guard.row_queue`).
"""

from __future__ import annotations

import json
import os
import threading
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import MALFORMED, InvalidField, InvalidFile
from carosac_toolkit.base.rotations import from_matrix
from carosac_toolkit.base.version import __version__
from carosac_toolkit.loop.values import Belief, Command, Imu, Measurement, Stamped
from carosac_toolkit.recordings.metadata import RecordingMetadata
from carosac_toolkit.recordings.poses import PoseSamples
from carosac_toolkit.recordings.recording import MEASURED_CHANNELS, Recording

RUN_SCHEMA = "carosac-run/1"
RUN_SUFFIX = ".jsonl"
SYNC_INTERVAL_S = 1.0  # [s] between two calls of fsync
CLOSE_TIMEOUT_S = 5.0  # [s] for the disk at the end


class CutRecording(UserWarning):
    """The last row of a recording was cut, and dropped."""


class CrashSafeRecorder:
    """Writes a run as it happens; a `carosac_toolkit.safety.guard.journal.Journal`.

    Attributes:
        path: The file.
        rows: Rows written up to now.
        samples: Measurements among them.
    """

    def __init__(
        self, path: str | Path, *, robot: str | None = None, description: str = ""
    ) -> None:
        """Make the file.

        Args:
            path: Ending in ``.jsonl``, in a folder that exists.
            robot: Name of a bundled robot or path of a robot file.
            description: Text for readers.

        Raises:
            InvalidField: Another suffix, or a file that is there already.
        """
        self.path = Path(path)
        self.rows = self.samples = 0
        if self.path.suffix != RUN_SUFFIX:
            raise InvalidField("recording", f"'{path}'", f"a file name ending in {RUN_SUFFIX}")
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND | getattr(os, "O_CLOEXEC", 0)
        try:
            self._file = os.open(self.path, flags, 0o644)
        except OSError as error:
            allowed = f"a new file in an existing folder: {error.strerror}"
            raise InvalidField("recording", f"'{path}'", allowed) from error
        self._lock = threading.Lock()
        self._error: OSError | None = None
        self._closing = threading.Event()
        metadata = RecordingMetadata(
            robot=robot, description=description, created_by=f"carosac-toolkit {__version__}"
        )
        self._row({"schema": RUN_SCHEMA, "metadata": metadata.to_dict()})
        self._sync = threading.Thread(target=self._sync_often, name="recording", daemon=True)
        self._sync.start()

    def measured(self, measurement: Measurement) -> None:
        """Record a measurement; a batch of one."""
        pose, imu = measurement.pose, measurement.imu
        row: dict[str, Any] = {
            "row": "measured",
            "time": float(measurement.time[0]),
            "unstrained_length": measurement.unstrained_length[0].tolist(),
        }
        for name in MEASURED_CHANNELS:
            channel = getattr(measurement, name)
            if channel is not None:
                row[name] = [float(channel.time[0]), channel.value[0].tolist()]
        if pose is not None:
            when = row["time"] if pose.time is None else float(pose.time[0])
            row["pose"] = [when, pose.position[0].tolist(), _quaternion(pose.rotation)]
        if imu is not None:
            row["imu"] = [
                imu.time[0].tolist(), imu.angular_rate[0].tolist(), imu.specific_force[0].tolist()
            ]  # fmt: skip
        if measurement.drive_status is not None:
            row["drive_status"] = list(measurement.drive_status)
        self._row(row)
        self.samples += 1

    def sent(self, asked: Command | None, sent: Command, *, really: bool) -> None:
        """Record the command asked for, None in a stop, and the one sent, or held back if dry."""
        row: dict[str, Any] = {
            "row": "sent" if really else "would_send",
            "time": float(sent.time[0]),
            "unstrained_length": sent.unstrained_length[0].tolist(),
        }
        if asked is not None:
            row["asked"] = asked.unstrained_length[0].tolist()
        if sent.limited:
            row["limited"] = [[x.limit, x.cable, x.asked, x.sent] for x in sent.limited]
        self._row(row)

    def believed(self, belief: Belief) -> None:
        """Record the belief of the estimator."""
        row: dict[str, Any] = {
            "row": "believed",
            "time": float(belief.time[0]),
            "position": belief.position[0].tolist(),
            "quaternion": _quaternion(belief.rotation),
        }
        if belief.twist is not None:
            row["twist"] = belief.twist[0].tolist()
        self._row(row)

    def event(self, time: float, name: str, text: str) -> None:
        """Record a change of state, a fault or a stop."""
        self._row({"row": "event", "time": time, "name": name, "text": text})

    def close(self, patience: float = CLOSE_TIMEOUT_S) -> bool:
        """Bring everything to the disk; safe to call twice.

        Args:
            patience: Longest wait for a blocked disk [s].

        Returns:
            True if everything is on the disk.
        """
        self._closing.set()
        self._sync.join(patience)
        return self._error is None and not self._sync.is_alive()

    def discard(self) -> None:
        """Close and remove the file of a run without content."""
        self.close()
        self.path.unlink(missing_ok=True)

    def _row(self, row: Mapping[str, Any]) -> None:
        """Hand a row to the system; after `close` there is none.

        Raises:
            OSError: The disk has failed, now or in the last `fsync`.
        """
        data = memoryview((json.dumps(row, separators=(",", ":")) + "\n").encode())
        if self._error is not None:
            raise self._error
        with self._lock:
            if self._file < 0:
                return
            while data:
                data = data[os.write(self._file, data) :]
            self.rows += 1

    def _sync_often(self) -> None:
        """Sync until closed, and once more then; in a thread, so that a slow disk delays no row."""
        try:
            while not self._closing.wait(SYNC_INTERVAL_S):
                os.fsync(self._file)
            os.fsync(self._file)
        except OSError as error:
            self._error = error
        with self._lock:
            os.close(self._file)
            self._file = -1


@dataclass(frozen=True, kw_only=True, eq=False)
class RecordedRun:
    """Contents of a file that `CrashSafeRecorder` wrote.

    Attributes:
        recording: Measurements and what was really sent.
        events: Time [s], name and text of each.
        asked: Commanded lengths that a controller asked for [m], (K, n) with their times, or None.
        would_send: Lengths that a dry run held back [m], (K, n) with their times, or None.
        believed: Positions that the estimator returned [m], (K, 3) with their times, or None.
        believed_poses: The same with their rotations.
        limited: Every limit hit as time [s], name, cable, value asked and value sent.
        cut: Number of the truncated row that was dropped; None: the file is complete.
    """

    recording: Recording
    events: tuple[tuple[float, str, str], ...]
    asked: Stamped | None
    would_send: Stamped | None
    believed: Stamped | None
    believed_poses: PoseSamples | None
    limited: tuple[tuple[float, str, int | None, float, float], ...]
    cut: int | None


def read_run(path: str | Path) -> RecordedRun:
    """Read a run, including one whose process was killed.

    Raises:
        InvalidFile: Another file, or one with a broken row before the last.
    """
    file = Path(path)
    rows, cut = _rows(file)
    head = rows[0] if rows else {}
    if not isinstance(head, dict) or head.get("schema") != RUN_SCHEMA:
        raise InvalidFile(file, [f"line 1: not a recorded run; allowed: schema {RUN_SCHEMA!r}"])
    try:
        return _run(head, _by_kind(rows[1:]), cut)
    except (*MALFORMED, InvalidField) as error:
        raise InvalidFile(file, [f"rows that do not belong to a run: {error}"]) from error


def read_crash_safe(path: Path) -> Recording:
    """Return the recording in a run; warn if the last row was cut."""
    run = read_run(path)
    if run.cut is not None:
        text = f"{path}: row {run.cut} was truncated and is dropped; all earlier rows are intact"
        warnings.warn(text, CutRecording, stacklevel=2)
    return run.recording


def _rows(file: Path) -> tuple[list[dict[str, Any]], int | None]:
    """Return all complete rows, and the number of the last one if it was cut."""
    lines = file.read_bytes().split(b"\n")
    cut = len(lines) if lines[-1] else None  # a whole row ends with its line
    rows: list[dict[str, Any]] = []
    for number, line in enumerate(lines[:-1], start=1):
        try:
            rows.append(json.loads(line))
        except (ValueError, RecursionError) as error:
            raise InvalidFile(file, [f"line {number}: not a JSON row: {error}"]) from error
    return rows, cut


def _by_kind(rows: Sequence[dict[str, Any]]) -> dict[str, list[dict[str, Any]]]:
    """Group rows by kind; drop measurements before the last homing: their offsets differ."""
    groups: dict[str, list[dict[str, Any]]] = {}
    for row in rows:
        groups.setdefault(str(row["row"]), []).append(row)
        if row.get("name") == "home":
            groups["before"] = groups.pop("measured", [])
    if not groups.get("measured"):
        groups["measured"] = groups.get("before", [])
    return groups


def _run(
    head: Mapping[str, Any], rows: Mapping[str, Sequence[dict[str, Any]]], cut: int | None
) -> RecordedRun:
    """Put the rows together."""
    measured = rows.get("measured", ())
    if not measured:
        raise InvalidField("rows", "no measurement", "one or more")
    sent, would = rows.get("sent", ()), rows.get("would_send", ())
    lengths = _stamped([(_sampled(row), row["unstrained_length"]) for row in measured])
    assert lengths is not None
    channels: dict[str, Any] = {
        name: _stamped([tuple(row[name]) for row in measured if name in row])
        for name in MEASURED_CHANNELS
    }
    recording = Recording(
        time=lengths.time,
        unstrained_length=lengths.value,
        command=_stamped([(row["time"], row["unstrained_length"]) for row in sent]),
        poses=_poses([row["pose"] for row in measured if "pose" in row]),
        imu=_imu(measured),
        metadata=RecordingMetadata.from_dict(head["metadata"]),
        **channels,
    )
    asked = [(row["time"], row["asked"]) for row in (*sent, *would) if "asked" in row]
    return RecordedRun(
        recording=recording,
        events=tuple((x["time"], x["name"], x["text"]) for x in rows.get("event", ())),
        asked=_stamped(asked),
        would_send=_stamped([(row["time"], row["unstrained_length"]) for row in would]),
        believed=_stamped([(row["time"], row["position"]) for row in rows.get("believed", ())]),
        believed_poses=_poses(
            [(x["time"], x["position"], x["quaternion"]) for x in rows.get("believed", ())]
        ),
        limited=tuple(
            (row["time"], *hit) for row in (*sent, *would) for hit in row.get("limited", ())
        ),
        cut=cut,
    )


def _sampled(row: Mapping[str, Any]) -> float:
    """Return the time at which the lengths of a row were measured [s]."""
    return float(row["length_rate"][0] if "length_rate" in row else row["time"])


def _stamped(pairs: Sequence[Any]) -> Stamped | None:
    """Return samples in order of their times; of several at one time the last counts."""
    samples = dict(sorted((float(time), value) for time, value in pairs))
    if not samples:
        return None
    return Stamped(
        time=np.array(list(samples)), value=np.array(list(samples.values()), dtype=float)
    )


def _poses(samples: Sequence[Sequence[Any]]) -> PoseSamples | None:
    """Return poses from times, positions and quaternions."""
    stamped = _stamped([(time, [*position, *quaternion]) for time, position, quaternion in samples])
    if stamped is None:
        return None
    return PoseSamples(
        time=stamped.time, position=stamped.value[:, :3], quaternion=stamped.value[:, 3:]
    )


def _imu(measured: Sequence[Mapping[str, Any]]) -> Imu | None:
    """Return all inertial samples."""
    stamped = _stamped(
        [
            (time, rate + force)
            for row in measured
            if "imu" in row
            for time, rate, force in zip(*row["imu"], strict=True)
        ]
    )
    if stamped is None:
        return None
    return Imu(
        time=stamped.time, angular_rate=stamped.value[:, :3], specific_force=stamped.value[:, 3:]
    )


def _quaternion(rotation: Array) -> list[float]:
    """Return the quaternion of the first rotation, order w x y z."""
    return [float(x) for x in from_matrix(rotation[:1])[0]]
