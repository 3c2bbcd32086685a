"""Reader of other programs' files: safe XML, finite numbers, all faults at once."""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidFile, MissingFile

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

_ORTHOGONALITY_TOLERANCE = 1e-4  # of R^T R
_FILE_BYTES_MAX = 2_000_000  # [bytes]; robots take kilobytes


class SourceFile:
    """File of another program, and its faults.

    Attributes:
        path: The file.
        faults: Faults found so far.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.faults: list[str] = []

    def fault(self, where: str, got: object, allowed: str) -> None:
        """Note one fault."""
        self.faults.append(f"{where}: got {got}; allowed: {allowed}")

    def check(self) -> None:
        """Refuse the file if anything is wrong.

        Raises:
            InvalidFile: With all faults.
        """
        if self.faults:
            raise InvalidFile(self.path, self.faults)

    def refuse(self, reason: str) -> InvalidFile:
        """Return the error for a file that cannot be used at all."""
        return InvalidFile(self.path, [reason])

    def text(self) -> str:
        """Return the content of the file.

        Raises:
            MissingFile: There is no such file.
            InvalidFile: It cannot be read.
        """
        if not self.path.exists():
            raise MissingFile(self.path)
        try:
            if self.path.stat().st_size > _FILE_BYTES_MAX:
                raise self.refuse(
                    f"larger than {_FILE_BYTES_MAX // 1_000_000} MB; this is no robot"
                )
            return self.path.read_text(encoding="utf-8-sig")
        except UnicodeDecodeError as error:
            raise self.refuse(f"not UTF-8 text (byte {error.start})") from error
        except OSError as error:
            raise self.refuse(f"cannot be read: {error.strerror}") from error

    def xml(self) -> Element:
        """Return the root of an XML file; own entities are refused, external ones never read.

        Raises:
            InvalidFile: No XML, or XML with entities.
        """
        from defusedxml.common import DefusedXmlException
        from defusedxml.ElementTree import ParseError, fromstring

        text = self.text()
        try:
            root: Element = fromstring(text.encode(), forbid_dtd=False)
        except ParseError as error:
            raise self.refuse(f"not XML: {error}") from error
        except DefusedXmlException as error:
            raise self.refuse("XML with entities of its own or external ones; refused") from error
        except (ValueError, LookupError) as error:
            raise self.refuse(f"not XML: {error}") from error
        return root

    def number(self, text: object, where: str, unit: str = "") -> float:
        """Return a finite number; NaN, and a fault, if it is none."""
        value = math.nan
        if isinstance(text, int | float) and not isinstance(text, bool):
            value = float(text) if abs(text) <= sys.float_info.max else math.inf
        elif isinstance(text, str) and "_" not in text:
            try:
                value = float(text)
            except ValueError:
                value = math.nan
        if not math.isfinite(value):
            got = "nothing" if text is None else repr(text)
            self.fault(where, got, f"a bare number{f' in {unit}' if unit else ''}")
            return math.nan
        return value

    def numbers(self, values: object, where: str, count: int, unit: str = "") -> Array:
        """Return that many finite numbers from a list, or a text with spaces between them."""
        entries = values.split() if isinstance(values, str) else values
        if not isinstance(entries, list) or len(entries) != count:
            got = "nothing" if values is None else repr(values)
            self.fault(where, got, f"{count} bare numbers{f' in {unit}' if unit else ''}")
            return np.full(count, math.nan)
        read = [self.number(entry, f"{where}[{i}]", unit) for i, entry in enumerate(entries)]
        return np.array(read)

    def rotation(self, matrix: Array, where: str) -> None:
        """Note a fault where a matrix is no rotation, to the digits that files have."""
        square = np.allclose(matrix.T @ matrix, np.eye(3), atol=_ORTHOGONALITY_TOLERANCE)
        if np.isfinite(matrix).all() and not (square and np.linalg.det(matrix) > 0.0):
            self.fault(where, "no rotation", "a rotation matrix, orthonormal and right-handed")

    def child(self, element: Element | None, tag: str, where: str) -> Element | None:
        """Return the child of a tag; note a fault if it is missing."""
        below = None if element is None else element.find(tag)
        if below is None and element is not None:
            self.fault(where, "nothing", f"an element <{tag}>")
        return below

    def child_number(self, element: Element, tag: str, where: str, unit: str = "") -> float:
        """Return the number in a child; note a fault if it is missing."""
        return self.number(element.findtext(tag), f"{where}/{tag}", unit)

    def attribute(self, element: Element, name: str, where: str, unit: str = "") -> float:
        """Return the number of an attribute; note a fault if it is missing."""
        return self.number(element.get(name), f"{where}@{name}", unit)


def about_centre_of_mass(inertia: Array, mass: float, centre: Array) -> Array:
    """Convert an inertia about the origin to the centre of mass (Steiner) [kg m^2], (3, 3)."""
    square = float(centre @ centre) * np.eye(3) - np.outer(centre, centre)
    return inertia - mass * square
