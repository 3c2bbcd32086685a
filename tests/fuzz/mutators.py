"""Damage to files and messages: of their bytes, their numbers, their lines and their JSON."""

from __future__ import annotations

import io
import json
import re
import zipfile
from collections.abc import Callable
from typing import Any

import numpy as np

Mutator = Callable[[bytes, np.random.Generator], bytes]

NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
EXTREMES = (
    b"0", b"-0.0", b"-1", b"1e308", b"-1e308", b"1e400", b"5e-324", b"nan", b"inf", b"-inf", b"NaN",
    b"Infinity", b"4294967296", b"18446744073709551616", b"1" * 400, b"1" * 5000, b"0x10", b"1_0",
    "\u0663".encode(), b"[1]", b"{}", b"null", b"true", b"''", b"\xff\xfe", b"\0", b"[" * 300,
)  # fmt: skip
VALUES: tuple[Any, ...] = (
    None, True, -1, 0, 1.5, 1e308, float("nan"), 10**400, "", "x", [], [1], [[1.0]], {}, {"a": 1},
)  # fmt: skip
DELIMITERS = re.compile(rb"([\s,:;=<>\"'\[\]{}]+)")
GROWN_MAX = 2**17  # bytes that are put in at once
RUN_MAX = 64  # bytes that are cut, copied or drawn at once


def flipped(data: bytes, rng: np.random.Generator) -> bytes:
    """Change some bytes."""
    changed = bytearray(data)
    for place in rng.integers(len(data), size=rng.integers(1, 9)):
        changed[place] = rng.choice([rng.integers(256), changed[place] ^ 1 << rng.integers(8), 255])
    return bytes(changed)


def truncated(data: bytes, rng: np.random.Generator) -> bytes:
    """Cut the end off."""
    return data[: rng.integers(len(data))]


def spliced(data: bytes, rng: np.random.Generator) -> bytes:
    """Put a run of bytes of the file elsewhere, over others or between them."""
    start, place = rng.integers(len(data), size=2)
    run = data[start : start + rng.integers(1, RUN_MAX)]
    return data[:place] + run + data[place + rng.choice([0, len(run)]) :]


def grown(data: bytes, rng: np.random.Generator) -> bytes:
    """Repeat a run of bytes up to thousands of times: long lines, wide headers, many rows."""
    start = rng.integers(len(data))
    run = data[start : start + rng.integers(1, RUN_MAX)]
    times = 2 ** int(rng.integers(4, 15))
    return data[:start] + (run * times)[:GROWN_MAX] + data[start:]


def removed(data: bytes, rng: np.random.Generator) -> bytes:
    """Take a run of bytes out."""
    start = rng.integers(len(data))
    return data[:start] + data[start + rng.integers(1, RUN_MAX) :]


def renumbered(data: bytes, rng: np.random.Generator) -> bytes:
    """Replace some numbers by extreme ones."""
    numbers = list(NUMBER.finditer(data))
    if not numbers:
        return flipped(data, rng)
    for index in sorted(rng.integers(len(numbers), size=rng.integers(1, 4)))[::-1]:
        start, stop = numbers[index].span()
        data = data[:start] + EXTREMES[rng.integers(len(EXTREMES))] + data[stop:]
    return data


def reworded(data: bytes, rng: np.random.Generator) -> bytes:
    """Replace a word by another one of the file, by nothing or by an extreme."""
    words = DELIMITERS.split(data)
    others = [words[rng.integers(len(words))], b"", EXTREMES[rng.integers(len(EXTREMES))]]
    words[rng.integers(len(words))] = others[rng.integers(3)]
    return b"".join(words)


def relined(data: bytes, rng: np.random.Generator) -> bytes:
    """Repeat, remove or exchange lines."""
    lines = data.splitlines(keepends=True)
    one, other = rng.integers(len(lines), size=2)
    kind = rng.integers(3)
    if kind == 0:
        lines.insert(one, lines[other])
    elif kind == 1:
        del lines[one]
    else:
        lines[one], lines[other] = lines[other], lines[one]
    return b"".join(lines)


def restructured(value: Any, rng: np.random.Generator) -> Any:
    """Replace or remove one part of nested JSON."""
    if isinstance(value, dict | list) and value and rng.random() < 0.8:
        keys = list(value) if isinstance(value, dict) else list(range(len(value)))
        key = keys[rng.integers(len(keys))]
        changed = value.copy()
        if rng.random() < 0.2:
            del changed[key]
        else:
            changed[key] = restructured(value[key], rng)
        return changed
    return VALUES[rng.integers(len(VALUES))]


def json_changed(data: bytes, rng: np.random.Generator) -> bytes:
    """Change a JSON document in its structure; another text as `renumbered` does."""
    try:
        document = json.loads(data)
    except (ValueError, RecursionError):
        return renumbered(data, rng)
    return json.dumps(restructured(document, rng)).encode()


def json_line_changed(data: bytes, rng: np.random.Generator) -> bytes:
    """Change one line of JSON in its structure."""
    lines = data.splitlines(keepends=True)
    index = rng.integers(len(lines))
    lines[index] = json_changed(lines[index], rng) + b"\n"
    return b"".join(lines)


def npz_changed(data: bytes, rng: np.random.Generator) -> bytes:
    """Replace, remove or damage one array of an npz file, whose checksums fit again."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as source:
            parts = {name: source.read(name) for name in source.namelist()}
    except Exception:  # damaged before, in one of many ways
        return flipped(data, rng)
    if not parts:
        return data
    name = list(parts)[rng.integers(len(parts))]
    kind = rng.integers(5)
    if kind == 0:
        del parts[name]
    elif kind == 1:
        parts[name] = parts[list(parts)[rng.integers(len(parts))]]
    elif kind == 2:
        parts[name] = MUTATORS_OF_BYTES[rng.integers(len(MUTATORS_OF_BYTES))](parts[name], rng)
    else:
        parts[name] = _npy_changed(parts[name], rng)
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as target:
        for name, content in parts.items():
            target.writestr(name, content)
    return stream.getvalue()


def _npy_changed(content: bytes, rng: np.random.Generator) -> bytes:
    """Change the values of an array, or the JSON in it."""
    try:
        array = np.load(io.BytesIO(content), allow_pickle=False)
    except Exception:  # damaged before
        return content
    if array.dtype.kind == "U" and array.ndim == 0:
        array = np.array(json_changed(str(array).encode(), rng).decode(errors="replace"))
    elif array.size and array.dtype.kind == "f":
        array.flat[rng.integers(array.size)] = rng.choice([np.nan, np.inf, -1e300, 0.0])
    else:
        array = np.zeros(rng.integers(0, 4, size=rng.integers(0, 3)))
    stream = io.BytesIO()
    np.save(stream, array, allow_pickle=False)
    return stream.getvalue()


MUTATORS_OF_BYTES: tuple[Mutator, ...] = (flipped, truncated, spliced, removed)
MUTATORS_OF_TEXT: tuple[Mutator, ...] = (*MUTATORS_OF_BYTES, renumbered, reworded, relined, grown)


def mutated(
    data: bytes, rng: np.random.Generator, mutators: tuple[Mutator, ...], times_max: int = 3
) -> bytes:
    """Damage data one to three times."""
    for _ in range(rng.integers(1, times_max + 1)):
        if not data:
            break
        data = mutators[rng.integers(len(mutators))](data, rng)
    return data
