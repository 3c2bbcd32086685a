"""One observation as a file holds it, before targets are looked up; and how faults are told."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from carosac_toolkit.base.errors import InvalidFile, MissingFile

MILLIMETRE_M = 1e-3


@dataclass(frozen=True, kw_only=True)
class Record:
    """One line of a file of observations.

    Attributes:
        setup: Name of the set-up.
        point: Name of the point, as the file has it.
        hz: Horizontal direction, clockwise, in face I [rad].
        v: Zenith angle, in face I [rad].
        distance: Slope distance as the file has it [m].
        prism_set: Prism constant that the instrument has added already [m]; None: not given.
        prism_constant: Constant to add, by the file [m]; None: not given.
        sighted: Sighted part, by the file; None: not given.
        rim_deg: Rim angle by the file [deg]; None: not given.
        path: The file.
        line: Its line, from 1.
    """

    setup: str
    point: str
    hz: float
    v: float
    distance: float
    path: str
    line: int
    prism_set: float | None = None
    prism_constant: float | None = None
    sighted: str | None = None
    rim_deg: float | None = None

    @property
    def source(self) -> str:
        """File and line."""
        return f"{Path(self.path).name}:{self.line}"


class LineFault(Exception):
    """Fault of a line of a file."""


def plain_name(text: str) -> str:
    """Return a point name without the zeros with which GSI fills its words."""
    return text.strip().lstrip("0") or "0"


def read_lines(path: str) -> list[str]:
    """Read the lines of a text file.

    Raises:
        MissingFile: There is none.
        InvalidFile: It is no text, or is empty.
    """
    if not Path(path).exists():
        raise MissingFile(path)
    try:
        text = Path(path).read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise InvalidFile(path, [f"not a text file (byte {error.start})"]) from error
    except OSError as error:
        raise InvalidFile(path, [f"cannot be read: {error.strerror}"]) from error
    if not text.strip():
        raise InvalidFile(path, ["the file is empty"])
    return text.splitlines()


def shortened_faults(faults: list[str], most: int = 12) -> list[str]:
    """Return the first faults, and how many more there are."""
    more = len(faults) - most
    return faults if more <= 0 else [*faults[:most], f"and {more} more"]
