"""Pictures as files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from carosac_toolkit.pictures.saving import check_picture, save_picture

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def save(figure: Figure, path: str | Path) -> Figure:
    """Write a figure as a whole or not at all, and give it back; see `save_picture`.

    Raises:
        InvalidField: The file cannot be written, or is no picture by its suffix.
    """
    check_picture("path", Path(path))
    save_picture(figure, Path(path))
    return figure
