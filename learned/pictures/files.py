"""Pictures as files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from carosac_toolkit.base.files import check_writable, replacing

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PICTURE_DPI = 130
PICTURE_SUFFIXES = (".png", ".svg", ".pdf")


def save(figure: Figure, path: str | Path) -> Figure:
    """Write a figure as a whole or not at all, and give it back.

    Raises:
        InvalidField: The file cannot be written, or is no picture by its suffix.
    """
    check_writable("path", Path(path), PICTURE_SUFFIXES)
    with replacing(Path(path)) as temporary:
        figure.savefig(temporary, dpi=PICTURE_DPI)
    return figure
