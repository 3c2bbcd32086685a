"""Checks of the arguments of a simulator: one clear message, before a kernel runs."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.robot.robot import Robot


def as_robots(value: object) -> list[Robot]:
    """Return the robots of a sequence; refuse anything else."""
    robots = list(value) if isinstance(value, Sequence) and not isinstance(value, str) else []
    if not robots or not all(isinstance(robot, Robot) for robot in robots):
        kinds = [type(x).__name__ for x in robots] if robots else repr(value)
        raise InvalidField("robot", kinds, "a Robot, or one for each world")
    return robots


def as_seeds(seed: int | Sequence[int], size: int) -> NDArray[np.int64]:
    """Return one seed for each world, below 2^31."""
    seeds = np.asarray(seed)
    if not np.issubdtype(seeds.dtype, np.integer) or (seeds < 0).any():
        raise InvalidField("seed", repr(seed), "a whole number >= 0, or one for each world")
    if seeds.ndim == 0:
        return (np.random.SeedSequence(int(seeds)).generate_state(size) % 2**31).astype(np.int64)
    if seeds.shape != (size,) or (seeds >= 2**31).any():
        allowed = f"one number, or {size} below 2^31, one for each world"
        raise InvalidField("seed", f"shape {seeds.shape}", allowed)
    return seeds.astype(np.int64)


def check_rows(name: str, value: Array, count: int) -> None:
    """Refuse a number of rows that is not the number of worlds."""
    if len(value) != count:
        raise InvalidField(name, f"shape {value.shape}", f"{count} rows, one for each world")


def check_lengths(name: str, value: Array) -> None:
    """Refuse lengths that are not positive."""
    if (value <= 0.0).any():
        b, i = (int(k) for k in np.argwhere(value <= 0.0)[0])
        raise InvalidField(f"{name}[{b}, {i}]", f"{value[b, i]} m", "> 0 m")
