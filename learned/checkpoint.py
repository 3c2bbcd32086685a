"""Checkpoints of trainings: one safetensors file whose header gives, as JSON, how its arrays nest.

Reading one runs no code: values are arrays, tensors, plain JSON, and dataclasses and
named tuples, whose fields are set one by one. A checksum covers all of it.
"""

from __future__ import annotations

import ast
import json
import sys
import zlib
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import MISSING, fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carosac_toolkit.base.errors import CarosacError, InvalidField, InvalidFile
from carosac_toolkit.base.files import replacing

CHECKPOINT_FILE = "checkpoint.safetensors"
FORMAT = "carosac-checkpoint/1"
OLD_CHECKPOINT_FILE = "checkpoint.pt"  # pickled, which runs code of the file when it is read

Arrays = dict[str, NDArray[Any]]


def write_checkpoint(path: Path, state: Mapping[str, Any]) -> None:
    """Write a state as a whole or not at all.

    Args:
        path: The file.
        state: Nested dicts, lists, tuples and dataclasses of arrays, tensors and plain values.

    Raises:
        InvalidField: Some value is of another type.
        CarosacError: The file cannot be written.
    """
    from safetensors.numpy import save_file

    arrays: Arrays = {}
    tree = json.dumps({key: _encoded(value, arrays, key) for key, value in state.items()})
    header = {"format": FORMAT, "state": tree, "crc32": str(_checksum(tree, arrays))}
    with replacing(path) as temporary:
        save_file(arrays, temporary, metadata=header)


def read_checkpoint(path: Path, names: Collection[str], packages: Collection[str]) -> Any:
    """Read parts of a state.

    Args:
        path: A file of `write_checkpoint`.
        names: Keys of the parts.
        packages: Whose dataclasses may be in them; the modules are imported already.

    Returns:
        The parts by name.

    Raises:
        InvalidFile: It is no checkpoint, is damaged, or lacks a part.
    """
    from safetensors import safe_open

    with refusing_damage(path):
        with safe_open(path, framework="numpy") as file:
            header = file.metadata() or {}
            if header.get("format") != FORMAT:
                raise InvalidFile(path, [f"not a checkpoint of format {FORMAT}"])
            arrays = {name: file.get_tensor(name) for name in file.keys()}
        if header["crc32"] != str(_checksum(header["state"], arrays)):
            raise ValueError("the checksum differs")
        tree = json.loads(header["state"])
        return {name: _decoded(tree[name], arrays, packages) for name in names}


@contextmanager
def refusing_damage(path: Path) -> Iterator[None]:
    """Name the file in whatever goes wrong with a state that was read from it.

    Raises:
        InvalidFile: Something did.
    """
    from safetensors import SafetensorError

    try:
        yield
    except CarosacError:
        raise
    except (
        SafetensorError, OSError, LookupError, TypeError, ValueError, AttributeError, RuntimeError,
        SyntaxError, MemoryError,
    ) as error:  # fmt: skip
        raise InvalidFile(path, [f"not a usable checkpoint; begin again: {error}"]) from error


def refuse_old_checkpoint(folder: Path) -> None:
    """Refuse a folder whose training was begun with a version that wrote pickled checkpoints.

    Raises:
        InvalidField: Names the folder.
    """
    if (folder / OLD_CHECKPOINT_FILE).exists() and not (folder / CHECKPOINT_FILE).exists():
        allowed = (
            f"a folder without {OLD_CHECKPOINT_FILE}: this training was begun with an older "
            "version, whose checkpoints are not read any more; begin again in another folder"
        )
        raise InvalidField("output", f"'{folder}'", allowed)


def packages_of(value: Any) -> set[str]:
    """Return the top-level packages of all dataclasses in a state."""
    if isinstance(value, Mapping):
        parts = list(value.values())
    elif isinstance(value, list | tuple):
        parts = list(value)
    elif is_dataclass(value):
        parts = list(_fields(value).values())
    else:
        return set()
    named = is_dataclass(value) or _is_named(value)
    own = {type(value).__module__.partition(".")[0]} if named else set()
    return own.union(*(packages_of(part) for part in parts))


def _encoded(value: Any, arrays: Arrays, where: str) -> Any:
    """Return a value as JSON holds it; arrays go into a table of their own."""
    if isinstance(value, np.ndarray) and value.dtype.fields is not None:
        layout = repr(np.lib.format.dtype_to_descr(value.dtype))
        plain = np.ascontiguousarray(value).view(np.uint8)
        return {"records": _kept(plain, arrays), "layout": layout}
    if isinstance(value, np.ndarray | np.generic):
        return {"number" if isinstance(value, np.generic) else "array": _kept(value, arrays)}
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, Mapping):
        return {"dict": [[k, _encoded(v, arrays, f"{where}.{k}")] for k, v in value.items()]}
    if isinstance(value, list | tuple):
        parts = [_encoded(part, arrays, f"{where}[{i}]") for i, part in enumerate(value)]
        if isinstance(value, list):
            return parts
        return {"tuple": parts, "class": _class_name(type(value)) if _is_named(value) else None}
    kind = type(value)
    if is_dataclass(value):
        return {"dataclass": _class_name(kind), "fields": _encoded(_fields(value), arrays, where)}
    if kind.__module__.partition(".")[0] == "torch":
        return {"tensor": _kept(value.detach().cpu().numpy(), arrays)}
    raise InvalidField(where, kind.__name__, "arrays, plain values and dataclasses of them")


def _fields(value: Any) -> dict[str, Any]:
    """Return the fields of a dataclass by name."""
    return {part.name: getattr(value, part.name) for part in fields(value)}


def _is_named(value: Any) -> bool:
    """Return whether a value is a named tuple."""
    return isinstance(value, tuple) and hasattr(value, "_fields")


def _class_name(kind: type) -> str:
    """Return a class as a file names it."""
    return f"{kind.__module__}:{kind.__qualname__}"


def _kept(value: Any, arrays: Arrays) -> str:
    """Add an array to the table; return its name there."""
    name = str(len(arrays))
    arrays[name] = np.asarray(value, order="C")
    return name


def _decoded(node: Any, arrays: Arrays, packages: Collection[str]) -> Any:
    """Return the value of `_encoded`."""
    if isinstance(node, list):
        return [_decoded(part, arrays, packages) for part in node]
    if not isinstance(node, dict):
        return node
    kind = next(iter(node), "")
    if kind == "dict":
        return {key: _decoded(value, arrays, packages) for key, value in node["dict"]}
    if kind == "tuple":
        parts = _decoded(node["tuple"], arrays, packages)
        named = tuple if node["class"] is None else _class(node["class"], packages)
        return tuple.__new__(named, parts)
    return _dataclass(node, arrays, packages) if kind == "dataclass" else _array(kind, node, arrays)


def _array(kind: str, node: dict[str, Any], arrays: Arrays) -> Any:
    """Return an array, a number of numpy, records or a tensor."""
    array = arrays[node[kind]]
    if kind == "tensor":
        import torch

        return torch.from_numpy(array)
    if kind == "records":
        return array.view(np.lib.format.descr_to_dtype(ast.literal_eval(node["layout"])))
    return array[()] if kind == "number" else array


def _dataclass(node: dict[str, Any], arrays: Arrays, packages: Collection[str]) -> Any:
    """Make a dataclass without running any of its code."""
    kind = _class(node["dataclass"], packages)
    values = _decoded(node["fields"], arrays, packages)
    made = object.__new__(kind)
    for part in fields(kind):
        if part.name not in values and part.default_factory is not MISSING:
            value = part.default_factory()  # of an earlier version, which had no such field
        elif part.name not in values and part.default is not MISSING:
            value = part.default
        else:
            value = values[part.name]
        object.__setattr__(made, part.name, value)
    return made


def _class(name: str, packages: Collection[str]) -> Any:
    """Return a dataclass or named tuple of a package that is allowed and imported already."""
    module, _, attribute = name.partition(":")
    if module.partition(".")[0] not in packages or module not in sys.modules:
        raise ValueError(f"unknown class {name!r}")
    kind = vars(sys.modules[module])[attribute]
    if not isinstance(kind, type) or not (is_dataclass(kind) or hasattr(kind, "_fields")):
        raise ValueError(f"{name!r} is no dataclass and no named tuple")
    return kind


def _checksum(tree: str, arrays: Arrays) -> int:
    """Return the CRC-32 of the nesting and of all bytes of the arrays."""
    checksum = zlib.crc32(tree.encode())
    for name in sorted(arrays):
        checksum = zlib.crc32(np.ravel(arrays[name]).view(np.uint8).data, checksum)
    return checksum
