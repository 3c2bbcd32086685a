"""Networks that come with the toolkit, by name, and those of a user, by path."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

from carosac_toolkit.base.errors import InvalidField, did_you_mean

NETWORK_SUFFIX = ".onnx"


def list_bundled(folder: str) -> tuple[str, ...]:
    """Return the names of the networks in a folder of this package, sorted."""
    return tuple(sorted(entry.stem for entry in _place(folder).glob(f"*{NETWORK_SUFFIX}")))


def find_bundled(name_or_path: str, folder: str) -> Path:
    """Find the file of a network.

    Args:
        name_or_path: A bundled name, or a path.
        folder: Of this package, with the bundled ones.

    Raises:
        InvalidField: There is none of that name.
    """
    names = list_bundled(folder)
    if name_or_path in names:
        return _place(folder) / f"{name_or_path}{NETWORK_SUFFIX}"
    path = Path(name_or_path)
    if path.suffix != NETWORK_SUFFIX and not path.exists():
        allowed = f"one of {list(names)}, or an .onnx file{did_you_mean(name_or_path, names)}"
        raise InvalidField("policy", repr(name_or_path), allowed)
    return path


def _place(folder: str) -> Path:
    return Path(str(files("learned") / folder))
