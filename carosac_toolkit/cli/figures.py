"""Draw the figures of the CaRoSaC paper from folders that other commands wrote.

Takes folders of carosac compare, validate, evaluate and train, or one above them, such as
carosac-results, and draws every figure whose data is there; of each that it cannot draw, it says
which command makes the data. Where several folders would do, the first one is drawn.

Example: carosac figures runs/compare runs/evaluate --output figures --formats pdf

Exit status 1 means that no figure was drawn.
"""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.tables import counted, terminal_width, wrapped
from carosac_toolkit.cli.common import CommandResult, CommonOptions, OutputFolder
from carosac_toolkit.loop import plugins
from carosac_toolkit.reports.page import write_files

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from carosac_toolkit.pictures.paper_figure import Drawn, PaperFigure

FIGURE_FORMATS = ("png", "pdf", "svg")
DEFAULT_FIGURES_FOLDER = Path("carosac-results") / "figures"
FIGURE_DPI = 200


@dataclass(frozen=True, kw_only=True)
class Options(CommonOptions):
    """Options of ``carosac figures``."""

    folders: Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="FOLDER")] = ()
    """Results folders; without any, only figures that need no data are drawn."""
    formats: tuple[str, ...] = ("png", "pdf")
    """File formats: `png`, `pdf` and `svg`."""
    output: OutputFolder = None
    """Folder for the figures; by default carosac-results/figures."""


def run(options: Options) -> CommandResult:
    """Draw the figures whose data is there, and name the missing ones."""
    from carosac_toolkit.pictures.paper_figure import find_sources

    for name in options.formats:
        if name not in FIGURE_FORMATS:
            raise InvalidField("--formats", repr(name), f"some of {list(FIGURE_FORMATS)}")
    if not options.formats:
        raise InvalidField("--formats", "none", f"some of {list(FIGURE_FORMATS)}")
    sources = find_sources(options.folders)
    folder = options.output or DEFAULT_FIGURES_FOLDER
    done: list[dict[str, Any]] = []
    skipped: list[dict[str, str]] = []
    for wanted in all_figures():
        drawn = wanted.draw(sources)
        if not drawn:
            skipped.append({"name": wanted.name, "what": wanted.what, "command": wanted.command})
        for one in drawn:
            done.append(_write(wanted, one, folder, options.formats))
    _print(done, skipped, folder)
    return CommandResult({"figures": done, "skipped": skipped}, status=0 if done else 1)


def all_figures() -> list[PaperFigure]:
    """Return the figures of all installed packages, in the order of the paper."""
    figures = [
        figure
        for name in plugins.names("figures")
        for figure in plugins.load("figures", name).FIGURES
    ]
    return sorted(figures, key=lambda figure: figure.place)


def _write(
    wanted: PaperFigure, drawn: Drawn, folder: Path, formats: Sequence[str]
) -> dict[str, Any]:
    """Write a figure in all formats."""
    parts = [f"{wanted.place:02d}", wanted.name, *([drawn.more] if drawn.more else [])]
    name = "_".join(parts)
    contents = {f"{name}.{suffix}": _rendered(drawn.figure, suffix) for suffix in formats}
    files = write_files(folder, contents)
    source = None if drawn.source is None else str(drawn.source)
    return {"name": name, "what": wanted.what, "source": source, "files": files}


def _rendered(figure: Figure, suffix: str) -> bytes:
    """Render a figure; vector files hold no date, so that equal figures give equal files."""
    stream = io.BytesIO()
    more: dict[str, Any] = {"dpi": FIGURE_DPI}
    if suffix != "png":
        more["metadata"] = {"Date": None} if suffix == "svg" else {"CreationDate": None}
    figure.savefig(stream, format=suffix, **more)
    return stream.getvalue()


def _print(done: Sequence[dict[str, Any]], skipped: Sequence[dict[str, str]], folder: Path) -> None:
    """Print the source of each figure, and what is missing."""
    width = terminal_width()
    for one in done:
        origin = f", from {one['source']}" if one["source"] is not None else ""
        print(wrapped(f"{one['name']}: {one['what']}{origin}", width))
    for line in _missing(skipped):
        print(wrapped(line, width))
    print(f"{counted(len(done), 'figure')} in {folder}, {len(skipped)} skipped")


def _missing(skipped: Sequence[dict[str, str]]) -> Iterator[str]:
    """Return what is missing, and the command that makes it."""
    for one in skipped:
        yield f"skipped {one['name']} ({one['what']}): its data is made by {one['command']}"
