"""Draw the figures of the CaRoSaC paper from folders that other commands wrote.

Takes folders of carosac compare, validate, evaluate and train, or one above them, such as
carosac-results, and draws every figure whose data is there; for the others, it says which commands
make their data. Where several folders would do, the first one is drawn.

Example: carosac figures runs/compare runs/evaluate --output figures --style paper

Exit status 1 means that no figure was drawn.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.tables import counted, terminal_width, wrapped
from carosac_toolkit.cli.common import CommandResult, CommonOptions, OutputFolder
from carosac_toolkit.loop import plugins
from carosac_toolkit.pictures.saving import PICTURE_FORMATS, picture_files
from carosac_toolkit.pictures.style import StyleName, using_style
from carosac_toolkit.reports.page import write_files

if TYPE_CHECKING:
    from carosac_toolkit.pictures.paper_figure import Drawn, PaperFigure

DEFAULT_FIGURES_FOLDER = Path("carosac-results") / "figures"


@dataclass(frozen=True, kw_only=True)
class Options(CommonOptions):
    """Options of ``carosac figures``."""

    folders: Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="FOLDER")] = ()
    """Results folders; without any, only figures that need no data are drawn."""
    formats: tuple[str, ...] = PICTURE_FORMATS
    """File formats: `png`, `svg` and `pdf`."""
    style: StyleName = "screen"
    """`paper`: serif fonts of 8 points. In either style, figures are as wide as one or two columns
    of an IEEE journal (3.5 or 7.16 inches)."""
    output: OutputFolder = None
    """Folder for the figures; by default carosac-results/figures."""


def run(options: Options) -> CommandResult:
    """Draw the figures whose data is there, and name the missing ones."""
    from carosac_toolkit.pictures.paper_figure import find_sources

    for name in options.formats or ("none",):
        if name not in PICTURE_FORMATS:
            raise InvalidField("--formats", repr(name), f"some of {list(PICTURE_FORMATS)}")
    sources = find_sources(options.folders)
    folder = options.output or DEFAULT_FIGURES_FOLDER
    done: list[dict[str, Any]] = []
    skipped: list[dict[str, str]] = []
    for wanted in all_figures():
        with using_style(options.style):
            drawn = wanted.draw(sources)
        if not drawn:
            skipped.append({"name": wanted.name, "what": wanted.what, "command": wanted.command})
        for one in drawn:
            done.append(_write(wanted, one, folder, options.formats))
    _print(done, skipped, folder, options.folders)
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
    files = write_files(folder, picture_files({name: drawn.figure}, formats))
    source = None if drawn.source is None else str(drawn.source)
    return {"name": name, "what": wanted.what, "source": source, "files": files}


def _print(
    done: Sequence[dict[str, Any]], skipped: Sequence[dict[str, str]], folder: Path,
    folders: Sequence[str],
) -> None:  # fmt: skip
    """Print the source of each figure, and which commands make what is missing."""
    width = terminal_width()
    for one in done:
        origin = f", from {one['source']}" if one["source"] is not None else ""
        print(wrapped(f"{one['name']}: {one['what']}{origin}", width))
    print(wrapped(f"{counted(len(done), 'figure')} in {folder}{_missing(skipped)}", width))
    if not folders:
        print(wrapped(_without_folder(skipped), width))


def _without_folder(skipped: Sequence[dict[str, str]]) -> str:
    """Return which figures need a folder with results, by the command that writes it."""
    names: dict[str, list[str]] = {}
    for one in skipped:
        names.setdefault(one["command"].split()[1], []).append(one["name"])
    each = [f"carosac {command} for {', '.join(figures)}" for command, figures in names.items()]
    return (
        "No folder with results was given: carosac figures FOLDER [FOLDER ...]. A folder is "
        f"written by {'; '.join(each)}."
    )


def _missing(skipped: Sequence[dict[str, str]]) -> str:
    """Return how many figures are missing, and how to get them."""
    commands = sorted({one["command"].split()[1] for one in skipped})
    if not commands:
        return ", none skipped"
    return (
        f"; {len(skipped)} skipped, whose data comes from carosac {', '.join(commands)} "
        "(--json FILE has the options)"
    )
