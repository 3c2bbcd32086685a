"""Pictures as files: PNG, SVG and PDF, equal bytes for equal figures."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from carosac_toolkit.base.files import check_writable, replacing

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PICTURE_FORMATS = ("png", "svg", "pdf")
PICTURE_DPI = 200  # of PNG, and of what is rasterized in SVG and PDF
TRUETYPE = 42  # kind of fonts in PDF: journals refuse those of kind 3, the default
_HASH_SALT = "carosac"  # ids in SVG follow from it and the content; by default they are random
_METADATA: Mapping[str, Mapping[str, Any]] = {
    "svg": {"Date": None}, "pdf": {"CreationDate": None}, "png": {},
}  # fmt: skip


def rendered(figure: Figure, format_name: str) -> bytes:
    """Render a figure in one of `PICTURE_FORMATS`, without a date, so that runs compare equal."""
    from matplotlib import rc_context

    stream = io.BytesIO()
    with rc_context({"svg.hashsalt": _HASH_SALT, "pdf.fonttype": TRUETYPE}):
        figure.savefig(stream, format=format_name, dpi=PICTURE_DPI, metadata=_METADATA[format_name])
    return stream.getvalue()


def picture_files(
    figures: Mapping[str, Figure], formats: Sequence[str] = PICTURE_FORMATS
) -> dict[str, bytes]:
    """Render figures, by default in all formats.

    Args:
        figures: Figures by name. Their layout is computed for the first format and then kept.
        formats: Some of `PICTURE_FORMATS`.

    Returns:
        Contents by file name, the formats of a figure side by side.
    """
    files: dict[str, bytes] = {}
    for name, figure in figures.items():
        if any(axes.get_aspect() != "auto" for axes in figure.axes):
            figure.draw_without_rendering()  # sizes of panels with equal scales settle in two steps
        for end in formats:
            files[f"{name}.{end}"] = rendered(figure, end)
            figure.set_layout_engine("none")  # as it is in the first format
    return files


def check_picture(option: str, path: Path | None) -> None:
    """Refuse a picture file that cannot be written, before any work is done.

    Raises:
        InvalidField: It cannot be written, or its suffix is that of no format.
    """
    for file in picture_paths(path) if path is not None else ():
        check_writable(option, file, tuple(f".{name}" for name in PICTURE_FORMATS))


def save_picture(figure: Figure, path: Path) -> list[Path]:
    """Write a figure in the format of the suffix, or without one in all formats.

    Returns:
        The files; each appears whole or not at all.
    """
    files = picture_paths(path)
    formats = [file.suffix.lower().removeprefix(".") for file in files]
    contents = picture_files({path.stem: figure}, formats)
    for file, content in zip(files, contents.values(), strict=True):
        with replacing(file) as temporary:
            temporary.write_bytes(content)
    return files


def picture_paths(path: Path) -> list[Path]:
    """Return the files that a picture is written to: one with a suffix, all formats without."""
    return [path] if path.suffix else [path.with_suffix(f".{end}") for end in PICTURE_FORMATS]


def png(figure: Figure) -> bytes:
    """Render a figure as PNG alone."""
    return rendered(figure, "png")
