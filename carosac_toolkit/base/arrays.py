"""Read-only float64 arrays, checked once on entry; evenly spread row indices."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeGuard

import numpy as np
from numpy.typing import ArrayLike, NDArray

from carosac_toolkit.base.errors import InvalidField

Array = NDArray[np.float64]


def as_floats(name: str, value: ArrayLike) -> Array:
    """Convert to float64, or say which field is not a number."""
    try:
        return np.array(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise InvalidField(name, repr(value), "numbers") from error


def frozen_array(name: str, value: ArrayLike, shape: tuple[int, ...]) -> Array:
    """Copy to a read-only float64 array of exactly this shape, all finite.

    Args:
        name: Field name for the error message.
        value: Anything numpy can turn into an array.
        shape: The shape it must have.

    Returns:
        A new array with ``writeable`` off, or the value itself if it is one already.

    Raises:
        InvalidField: A wrong shape, or an entry that is not finite (named by its index).
    """
    array = value if _is_frozen(value) else as_floats(name, value)
    if array.shape != shape:
        raise InvalidField(name, f"shape {array.shape}", f"shape {shape}")
    _check_finite(name, array)
    array.setflags(write=False)
    return array


def batch(name: str, value: ArrayLike, trailing: tuple[int, ...]) -> Array:
    """Check an argument of shape (B, *trailing), finite, B >= 1; return it as contiguous float64.

    Raises:
        InvalidField: A missing batch axis, a wrong trailing shape or a value that is not finite.
    """
    array = as_floats(name, value)
    if array.ndim != 1 + len(trailing) or array.shape[1:] != trailing or len(array) == 0:
        allowed = "(B, " + ", ".join(map(str, trailing)) + ")" if trailing else "(B,)"
        raise InvalidField(name, f"shape {array.shape}", f"shape {allowed}, B >= 1")
    _check_finite(name, array)
    return np.ascontiguousarray(array)


def _is_frozen(value: ArrayLike) -> TypeGuard[Array]:
    """Return whether nobody can write to this array: a long recording is not copied again."""
    return (
        type(value) is np.ndarray
        and value.dtype == np.float64
        and bool(value.flags.owndata and value.flags.c_contiguous)
        and not value.flags.writeable
    )


def _check_finite(name: str, array: Array) -> None:
    """Refuse an entry that is not finite, named by its index."""
    if not np.isfinite(array).all():
        index = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        where = f"{name}[{', '.join(map(str, index))}]" if index else name
        raise InvalidField(where, array[index], "a finite number")


def check_rotations(name: str, rotation: Array) -> None:
    """Refuse matrices that are no rotations.

    Args:
        name: Field name for the error message.
        rotation: Shape (B, 3, 3), finite.

    Raises:
        InvalidField: Names the first one that is not orthonormal or mirrors.
    """
    product = rotation @ rotation.swapaxes(1, 2)
    bad = (np.abs(product - np.eye(3)).max(axis=(1, 2)) > 1e-6) | (np.linalg.det(rotation) < 0.0)
    if bad.any():
        index = int(np.argmax(bad))
        raise InvalidField(f"{name}[{index}]", "not a rotation matrix", "R R^T = 1, det +1")


def rotations(name: str, value: ArrayLike, size: int) -> Array:
    """Check an argument of one rotation matrix for each of `size` poses, shape (size, 3, 3).

    Raises:
        InvalidField: A wrong shape, a value that is not finite, or no rotation.
    """
    turn = batch(name, value, (3, 3))
    if len(turn) != size:
        raise InvalidField(name, f"shape {turn.shape}", f"shape ({size}, 3, 3)")
    check_rotations(name, turn)
    return turn


def set_frozen(instance: Any, shapes: Mapping[str, tuple[int, ...]]) -> None:
    """Replace the named fields of a frozen dataclass by their `frozen_array`."""
    for name, shape in shapes.items():
        object.__setattr__(instance, name, frozen_array(name, getattr(instance, name), shape))


def evenly(count: int, most: int) -> NDArray[np.int64]:
    """Return at most so many of `count` indices, evenly spread, first and last among them."""
    return np.linspace(0, count - 1, min(count, most)).round().astype(np.int64)
