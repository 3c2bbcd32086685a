"""Figures for a paper: content, source, and the command that makes the data."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from carosac_toolkit.base.errors import InvalidField

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SourceKind = Literal["study", "validation", "evaluation", "training"]
MARKER_FILES: Mapping[str, SourceKind] = {  # a file that tells what a folder is
    "study.json": "study",
    "samples.npz": "validation",
    "scores.npz": "evaluation",
    "curve.csv": "training",
}
SEARCH_DEPTH_MAX = 6  # folders below one that was named
FOLDERS_MAX = 10_000  # below one that was named: more is a disk


@dataclass(frozen=True, kw_only=True)
class FigureSource:
    """Folder that one of our commands wrote.

    Attributes:
        kind: Command that wrote it.
        folder: Path of the folder.
    """

    kind: SourceKind
    folder: Path


@dataclass(frozen=True, kw_only=True)
class Drawn:
    """Figure, and the source of its numbers.

    Attributes:
        figure: The figure.
        source: Source of its numbers; None if it has none.
        more: Part of the file name that tells it from others of the same kind.
    """

    figure: Figure
    source: Path | None = None
    more: str = ""


@dataclass(frozen=True, kw_only=True)
class PaperFigure:
    """One figure of the paper.

    Attributes:
        place: Its place among all figures.
        name: Name of its file.
        what: Content of the figure.
        command: Command that makes its data.
        draw: Draws it from the sources that there are; none where they do not suffice.
    """

    place: int
    name: str
    what: str
    command: str
    draw: Callable[[Sequence[FigureSource]], list[Drawn]]


def find_sources(folders: Sequence[str]) -> list[FigureSource]:
    """Find all folders that our commands wrote, in some folders and below them.

    Raises:
        InvalidField: A folder is not there, or holds nothing of ours.
    """
    sources: list[FigureSource] = []
    for name in folders:
        top = Path(name)
        if not top.is_dir():
            raise InvalidField("FOLDER", f"'{name}'", "a folder that is there")
        here = _sources_below(top)
        if not here:
            allowed = "a folder that carosac compare, validate, evaluate or train wrote"
            raise InvalidField("FOLDER", f"'{name}'", allowed)
        sources += [one for one in here if one not in sources]
    return sources


def _sources_below(top: Path) -> list[FigureSource]:
    """Find the folders of ours below a folder, the outermost first."""

    def refuse(error: OSError) -> None:
        allowed = f"a folder that can be searched: {error.strerror}: {error.filename}"
        raise InvalidField("FOLDER", f"'{top}'", allowed) from error

    kinds, found = list(MARKER_FILES.items()), []
    for seen, (folder, inner, files) in enumerate(os.walk(top, onerror=refuse)):
        if seen > FOLDERS_MAX:
            allowed = f"a folder with at most {FOLDERS_MAX} folders in it: name those of the runs"
            raise InvalidField("FOLDER", f"'{top}'", allowed)
        path = Path(folder)
        depth = len(path.relative_to(top).parts)
        if depth == SEARCH_DEPTH_MAX - 1:
            inner.clear()
        found += [(depth, k, path) for k, (mark, _) in enumerate(kinds) if mark in files]
    return [FigureSource(kind=kinds[k][1], folder=path) for _, k, path in sorted(found)]


def of_kind(sources: Sequence[FigureSource], kind: SourceKind) -> list[Path]:
    """Return the folders of a kind, in their order."""
    return [source.folder for source in sources if source.kind == kind]
