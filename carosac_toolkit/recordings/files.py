"""Read and write recordings: choice of format, and atomic writes."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path

import numpy as np

from carosac_toolkit.base.errors import InvalidField, InvalidFile, MissingFile, nearest_name
from carosac_toolkit.base.file_limits import check_text_size
from carosac_toolkit.base.files import replacing
from carosac_toolkit.recordings.columns import POSE_COLUMNS_TEXT
from carosac_toolkit.recordings.conversion import check_size
from carosac_toolkit.recordings.crash_safe import read_crash_safe
from carosac_toolkit.recordings.csv_file import read_csv, write_csv
from carosac_toolkit.recordings.parquet_file import read_parquet, write_parquet
from carosac_toolkit.recordings.recording import Recording
from carosac_toolkit.recordings.scampi_mat import read_scampi_mat

READERS_BY_SUFFIX: dict[str, Callable[[Path], Recording]] = {
    ".parquet": read_parquet,
    ".csv": read_csv,
    ".mat": read_scampi_mat,
    ".jsonl": read_crash_safe,
}
WRITERS_BY_SUFFIX: dict[str, Callable[[Recording, Path], None]] = {
    ".parquet": write_parquet,
    ".csv": write_csv,
}
_SUFFIX_BY_MAGIC = {b"PAR1": ".parquet", b"MATLAB": ".mat"}


def load_recording(path: str | Path) -> Recording:
    """Read a recording.

    ``.parquet`` or ``.csv`` (`carosac_toolkit.recordings`), SCAMPI ``.mat``, or the ``.jsonl`` of
    a run (`carosac_toolkit.recordings.crash_safe`).

    Args:
        path: The file.

    Raises:
        MissingFile: There is no such file.
        InvalidField: A suffix that is not known.
        InvalidFile: A file that is no recording, with all its faults in one message.
    """
    file = Path(path)
    suffix = file.suffix.lower()
    if file.is_dir():
        raise InvalidFile(file, ["this is a folder; allowed: a recording file"])
    if not file.is_file():
        raise MissingFile(file, neighbour(file))
    if suffix not in READERS_BY_SUFFIX:
        allowed = f"a recording with suffix {', '.join(READERS_BY_SUFFIX)}"
        raise InvalidField("path", f"suffix {file.suffix!r} of {str(file)!r}", allowed)
    with file.open("rb") as stream:
        start = stream.read(8)
    if not start:
        raise InvalidFile(file, ["the file is empty"])
    content = next(
        (kind for magic, kind in _SUFFIX_BY_MAGIC.items() if start.startswith(magic)), suffix
    )
    if content != suffix:
        raise InvalidFile(file, [f"the content is that of a {content} file; rename it"])
    return READERS_BY_SUFFIX[suffix](file)


def save_recording(recording: Recording, path: str | Path) -> None:
    """Write ``.parquet`` or ``.csv``, lossless, and whole or not at all.

    Raises:
        InvalidField: Another suffix, or a folder that is not there.
        InvalidFile: It would be too large to be read again.
    """
    file = Path(path)
    writer = WRITERS_BY_SUFFIX.get(file.suffix.lower())
    if writer is None:
        allowed = f"suffix {' or '.join(WRITERS_BY_SUFFIX)}"
        raise InvalidField("path", f"suffix {file.suffix!r} of {str(file)!r}", allowed)
    check_size(recording, file)
    with _replacing(file) as temporary:
        writer(recording, temporary)
        check_text_size(file, temporary.stat().st_size)


def export_tum(recording: Recording, path: str | Path) -> None:
    """Write the poses as a TUM trajectory: ``timestamp tx ty tz qx qy qz qw`` per line.

    Raises:
        InvalidField: The recording has no poses, or a folder that is not there.
    """
    poses = recording.poses
    if poses is None:
        raise InvalidField("poses", None, POSE_COLUMNS_TEXT)
    rows = np.column_stack([poses.time, poses.position, poses.quaternion[:, [1, 2, 3, 0]]])
    text = "\n".join(" ".join(map(repr, row)) for row in rows.tolist()) + "\n"
    with _replacing(Path(path)) as temporary:
        temporary.write_text("# timestamp tx ty tz qx qy qz qw\n" + text, encoding="utf-8")


def _replacing(file: Path) -> AbstractContextManager[Path]:
    """Give a temporary path for a file, whose folder must be there."""
    if not file.parent.is_dir():
        raise InvalidField("path", repr(str(file)), "a file in an existing folder")
    return replacing(file)


def neighbour(file: Path) -> str:
    """Suggest a recording or table of a similar name in the same folder, or say nothing."""
    if not file.parent.is_dir():
        return f"there is no folder {str(file.parent)!r}"
    names = [
        entry.name for entry in file.parent.iterdir() if entry.suffix.lower() in READERS_BY_SUFFIX
    ]
    near = nearest_name(file.name, names)
    return f"did you mean {str(file.with_name(near))!r}?" if near else ""
