"""Failure of a check, and helpers that all checks share."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import CarosacError, InvalidField
from carosac_toolkit.robot.robot import Robot

Factory = Callable[..., Any]  # factory(robot, seed=...) makes a plug-in
Check = Callable[[Factory, Robot], None]

CHECK_SEED = 3
BATCH_TOLERANCE_M = 1e-9  # [m], between rows computed together and alone


class NotConforming(CarosacError, AssertionError):
    """Error of a plug-in that breaks its contract."""


def run_all(
    kind: str, checks: Mapping[str, Check], factory: Factory, robot: Robot, skip: tuple[str, ...]
) -> None:
    """Run all checks and report all failures at once.

    Raises:
        NotConforming: One line per failed check.
        InvalidField: A name in `skip` that is no check.
    """
    for name in skip:
        if name not in checks:
            raise InvalidField("skip", repr(name), f"some of {list(checks)}")
    faults = []
    for name, check in checks.items():
        if name in skip:
            continue
        try:
            check(factory, robot)
        except (CarosacError, AssertionError) as error:
            faults.append(f"{name}: {error}")
        except Exception as error:
            faults.append(f"{name}: got {type(error).__name__}: {error}; allowed: a CarosacError")
    if faults:
        raise NotConforming("\n  ".join([f"{kind}: {len(faults)} of its checks failed", *faults]))


def require(condition: object, message: str) -> None:
    """Raise `NotConforming` unless the condition holds."""
    if not condition:
        raise NotConforming(message)


@contextmanager
def only_clear_errors(doing: str) -> Iterator[None]:
    """Let deliberate errors through; any other, and any NaN that was made, breaks the contract."""
    try:
        yield
    except InvalidField as error:
        if error.allowed == "a finite number":
            raise NotConforming(
                f"{doing}: it produced a number that is not finite: {error}"
            ) from error
        raise
    except CarosacError:
        raise
    except Exception as error:
        message = f"{type(error).__name__}: {error}"
        raise NotConforming(f"{doing}: got {message}; allowed: a CarosacError") from error


def refuses(doing: str, action: Callable[[], object]) -> bool:
    """Return whether an action ends in a clear error; an unclear one breaks the contract."""
    try:
        with only_clear_errors(doing):
            action()
    except NotConforming:
        raise
    except CarosacError:
        return True
    return False


def require_same(one: list[Array], other: list[Array], message: str) -> None:
    """Require two series of arrays to agree bit by bit."""
    same = len(one) == len(other) and all(map(np.array_equal, one, other))
    if not same:
        pairs = zip(one, other, strict=False)
        where = next((k for k, (a, b) in enumerate(pairs) if not np.array_equal(a, b)), None)
        detail = f"lengths {len(one)}, {len(other)}" if where is None else f"first at step {where}"
        raise NotConforming(f"{message} ({detail})")


def require_repeatable(collect: Callable[[], list[Array]], message: str) -> None:
    """Require two calls to agree bit by bit, whatever else draws random numbers between them."""
    one = collect()
    np.random.random(7)  # noqa: NPY002 - somebody else's draw
    require_same(one, collect(), message)


def require_close(one: Array, other: Array, message: str, tolerance: float) -> None:
    """Require two arrays to agree within a tolerance."""
    difference = float(np.abs(one - other).max()) if one.shape == other.shape else np.inf
    require(difference <= tolerance, f"{message}: got a difference of {difference:.3g}; "
            f"allowed: {tolerance:g}")  # fmt: skip
