"""Outputs: checked before any work is done, and written as a whole or not at all."""

from __future__ import annotations

import csv
import json
import math
import os
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from carosac_toolkit.base.errors import MALFORMED, CarosacError, InvalidField, InvalidFile


def check_writable(option: str, path: Path | None, suffixes: Sequence[str] = ()) -> None:
    """Refuse an output file that cannot be written, before any work is done.

    Raises:
        InvalidField: The folder does not exist or no file can be made in it, the path is a folder,
            a device or read-only, or its suffix is not one of `suffixes`.
    """
    if path is None:
        return
    if os.path.isdir(path):
        raise InvalidField(option, f"'{path}'", "a file, not a folder")
    if suffixes and path.suffix.lower() not in suffixes:
        raise InvalidField(option, f"'{path}'", f"a file name ending in {' or '.join(suffixes)}")
    if os.path.exists(path) and not os.path.isfile(path):
        raise InvalidField(option, f"'{path}'", "a regular file, no device or pipe")
    if os.path.exists(path) and not os.access(path, os.W_OK):
        raise InvalidField(option, f"'{path}'", "a file that may be written; this one is read-only")
    if not os.path.isdir(path.parent):
        raise InvalidField(option, f"'{path}'", f"a file in an existing folder; no {path.parent}/")
    try_folder(option, path, path.parent)


def try_folder(option: str, path: Path, folder: Path) -> None:
    """Make a file in a folder and remove it; no other test is sure (mounts, permissions, quota).

    Args:
        option: The option that names the output.
        path: The output.
        folder: Where it is to be made.

    Raises:
        InvalidField: No file can be made there.
    """
    try:
        _temporary_beside(folder / path.name).unlink()
    except OSError as error:
        allowed = f"a path in a folder that can be written; {folder}/: {error.strerror}"
        raise InvalidField(option, f"'{path}'", allowed) from error


def missing_folders(folder: Path) -> list[Path]:
    """A folder and those above it, as far as they are not there, the innermost first."""
    return [each for each in (folder, *folder.parents) if not each.exists()]


def remove_empty(folders: Sequence[Path]) -> None:
    """Remove folders in their order; those that somebody else uses by now stay."""
    for each in folders:
        with suppress(OSError):
            each.rmdir()


@contextmanager
def refusing(path: str | Path, what: str) -> Iterator[None]:
    """Refuse the file that is read in the block, if its data have another form than is expected.

    Args:
        path: The file.
        what: What it should be: ``a file written by carosac train``.

    Raises:
        InvalidFile: Something is wrong with it.
    """
    try:
        yield
    except (*MALFORMED, csv.Error) as error:
        reason = f"{type(error).__name__}: {error}"
        raise InvalidFile(path, [f"damaged, or not {what} ({reason})"]) from error


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Give a temporary path beside `path` that takes its place, on the disk, if all goes well.

    Yields:
        The temporary path, with the suffix of `path`, to be written in the block.

    Raises:
        CarosacError: The file cannot be written, such as on a full disk.
    """
    temporary: Path | None = None
    try:
        temporary = _temporary_beside(path)
        yield temporary
        with temporary.open("rb") as written:
            os.fsync(written.fileno())
        mask = os.umask(0)
        os.umask(mask)
        temporary.chmod(0o666 & ~mask)
        temporary.replace(path)
    except OSError as error:
        raise CarosacError(f"{path}: cannot be written: {error.strerror or error}") from error
    finally:
        if temporary is not None:
            temporary.unlink(missing_ok=True)


def _temporary_beside(path: Path) -> Path:
    """Make an empty temporary file in the folder of `path`, with its suffix."""
    handle, name = tempfile.mkstemp(prefix=f".{path.stem}-", suffix=path.suffix, dir=path.parent)
    os.close(handle)
    return Path(name)


def write_json(path: Path, data: Mapping[str, Any]) -> None:
    """Write numbers as JSON, atomically; a number that is not finite becomes null."""
    text = json.dumps(_plain(data), indent=2, allow_nan=False, ensure_ascii=False)
    with replacing(path) as temporary:
        temporary.write_text(text + "\n", encoding="utf-8")


def _plain(value: Any) -> Any:
    """Turn numpy values, tuples and paths into what JSON knows."""
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, Mapping):
        return {str(key): _plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(entry) for entry in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return str(value) if isinstance(value, Path) else value
