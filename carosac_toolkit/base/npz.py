"""One ``.npz`` file for arrays and what goes with them as JSON, readable with numpy alone."""

from __future__ import annotations

import io
import json
import zlib
from collections.abc import Callable
from pathlib import Path
from tokenize import TokenError
from typing import Any, TypeVar
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from carosac_toolkit.base.errors import MALFORMED, InvalidField, MissingFile
from carosac_toolkit.base.file_limits import check_decoded
from carosac_toolkit.base.files import replacing

T = TypeVar("T")
# What numpy and zipfile raise over a damaged archive; RuntimeError: it is encrypted.
DAMAGED_ARCHIVE = (
    OSError, EOFError, BadZipFile, SyntaxError, TokenError, RuntimeError, MemoryError, zlib.error,
)  # fmt: skip


def write_npz(path: str | Path, key: str, rest: Any, arrays: dict[str, NDArray[Any]]) -> None:
    """Write a file as a whole or not at all.

    Args:
        path: In a folder that exists.
        key: Name under which `rest` is kept.
        rest: What JSON can hold.
        arrays: By name.

    Raises:
        MissingFile: The folder does not exist.
    """
    target = Path(path)
    if not target.parent.is_dir():
        raise MissingFile(target.parent, "the folder must exist")
    with replacing(target) as temporary:
        temporary.write_bytes(npz_bytes(key, rest, arrays))


def npz_bytes(key: str, rest: Any, arrays: dict[str, NDArray[Any]]) -> bytes:
    """The content of such a file."""
    stream = io.BytesIO()
    np.savez(stream, allow_pickle=False, **{key: np.array(json.dumps(rest))}, **arrays)
    return stream.getvalue()


def read_npz(
    path: str | Path, key: str, writer: str, build: Callable[[Any, dict[str, NDArray[Any]]], T]
) -> T:
    """Read what `write_npz` wrote, and build what it stands for.

    Args:
        path: The file.
        key: As it was written.
        writer: Who writes such files, for the error message.
        build: Builds the result from the rest and the arrays by name.

    Raises:
        MissingFile: There is no such file.
        InvalidField: It is no such file.
    """
    if not Path(path).is_file():
        raise MissingFile(path)
    try:
        with np.load(path, allow_pickle=False) as data:
            check_decoded(path, sum(entry.file_size for entry in data.zip.infolist()))
            return build(json.loads(str(data[key])), {k: data[k] for k in data.files if k != key})
    except (*MALFORMED, *DAMAGED_ARCHIVE) as error:
        raise InvalidField("path", path, f"a file written by {writer}") from error
