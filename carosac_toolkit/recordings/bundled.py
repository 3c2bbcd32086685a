"""Recordings that come with the toolkit, by name."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

from carosac_toolkit.base.errors import InvalidField, did_you_mean

_RECORDING_SUFFIX = ".parquet"


def list_recordings() -> tuple[str, ...]:
    """Name the recordings that come with the toolkit, sorted."""
    return tuple(sorted(entry.stem for entry in _folder().glob(f"*{_RECORDING_SUFFIX}")))


def find_recording(name_or_path: str | Path) -> Path:
    """Return the file of a bundled recording, or the path as it is.

    Args:
        name_or_path: A bundled name, or a path: anything with a suffix or a folder in it, and any
            file that exists.

    Raises:
        InvalidField: A bare name that is neither bundled nor a file.
    """
    path = Path(name_or_path)
    text = str(name_or_path)
    if isinstance(name_or_path, Path) or path.suffix or "/" in text or "\\" in text:
        return path
    names = list_recordings()
    if text in names:
        return _folder() / f"{text}{_RECORDING_SUFFIX}"
    if path.exists():
        return path
    hint = did_you_mean(text, names)
    allowed = f"one of {list(names)}, or a path to a .parquet, .csv or .mat file{hint}"
    raise InvalidField("recording", f"'{text}'", allowed)


def _folder() -> Path:
    """Return the folder of the bundled recordings."""
    return Path(str(files("carosac_toolkit") / "recordings" / "data"))
