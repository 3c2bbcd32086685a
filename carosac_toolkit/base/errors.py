"""Deliberate errors of the toolkit: each names the field, the value and the allowed values."""

from __future__ import annotations

from collections.abc import Sequence
from difflib import get_close_matches
from typing import Any

# What Python raises over data of another form than a reader expects.
MALFORMED = (
    ValueError, TypeError, LookupError, AttributeError, ArithmeticError, RecursionError,
)  # fmt: skip


class CarosacError(Exception):
    """Base of all errors raised on purpose; the command line prints it and exits with status 2."""

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle message and attributes, whatever the arguments were: it may come from a worker."""
        return _restored, (type(self), self.args, self.__dict__)


class InvalidField(CarosacError):
    """A value outside what its field allows.

    Attributes:
        field: Name of the field or argument, with an index where it has one: ``tension_min[3]``.
        value: The value as the user wrote it, with its unit.
        allowed: Accepted values.
    """

    def __init__(self, field: str, value: object, allowed: str) -> None:
        super().__init__(f"{field}: got {value}; allowed: {allowed}")
        self.field = field
        self.value = value
        self.allowed = allowed


class InvalidFile(CarosacError):
    """A file with one or more faults, all of them in one message.

    Attributes:
        path: The file.
        faults: One line per fault.
    """

    def __init__(self, path: object, faults: Sequence[str]) -> None:
        count = f"{len(faults)} fault" + ("s" if len(faults) != 1 else "")
        super().__init__("\n  ".join([f"{path}: {count}", *faults]))
        self.path = str(path)
        self.faults = tuple(faults)


class MissingFile(CarosacError):
    """A file that is not there."""

    def __init__(self, path: object, hint: str = "") -> None:
        super().__init__(f"{path}: no such file" + (f"; {hint}" if hint else ""))
        self.path = str(path)


def nearest_name(name: object, names: Sequence[str]) -> str | None:
    """Return the most similar of some names, or None if none is similar."""
    close = get_close_matches(str(name), names, n=1)
    return close[0] if close else None


def did_you_mean(name: object, names: Sequence[str]) -> str:
    """Ask for the most similar of some names, to be put after what is allowed; or say nothing."""
    near = nearest_name(name, names)
    return f"; did you mean '{near}'?" if near else ""


def _restored(
    kind: type[CarosacError], args: tuple[Any, ...], attributes: dict[str, Any]
) -> CarosacError:
    """Rebuild a pickled error."""
    error = kind.__new__(kind, *args)
    error.__dict__.update(attributes)
    return error
