"""Checks of what a simulator is asked for: one clear message, before a kernel runs."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.robot.robot import Robot


def as_robots(given: object) -> list[Robot]:
    """The robots of a sequence, checked."""
    robots = list(given) if isinstance(given, Sequence) and not isinstance(given, str) else []
    if not robots or not all(isinstance(robot, Robot) for robot in robots):
        kinds = [type(x).__name__ for x in robots] if robots else repr(given)
        raise InvalidField("robot", kinds, "a Robot, or one for each world")
    return robots


def as_seeds(seed: int | Sequence[int], size: int) -> NDArray[np.int64]:
    """One seed for each world, below 2^31."""
    given = np.asarray(seed)
    if not np.issubdtype(given.dtype, np.integer) or (given < 0).any():
        raise InvalidField("seed", repr(seed), "a whole number >= 0, or one for each world")
    if given.ndim == 0:
        words = np.random.SeedSequence(int(given)).generate_state(size)
        return (words % 2**31).astype(np.int64)
    if given.shape != (size,) or (given >= 2**31).any():
        allowed = f"one number, or {size} below 2^31, one for each world"
        raise InvalidField("seed", f"shape {given.shape}", allowed)
    return given.astype(np.int64)


def check_rows(name: str, value: Array, count: int) -> None:
    """Refuse another number of rows than there are worlds."""
    if len(value) != count:
        allowed = f"{count} rows, one for each world"
        raise InvalidField(name, f"shape {value.shape}", allowed)


def check_lengths(name: str, value: Array) -> None:
    """Refuse lengths that are not positive."""
    if (value <= 0.0).any():
        b, i = (int(k) for k in np.argwhere(value <= 0.0)[0])
        raise InvalidField(f"{name}[{b}, {i}]", f"{value[b, i]} m", "> 0 m")
