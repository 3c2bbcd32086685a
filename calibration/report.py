"""What the reports of all calibrations share: tables of parameters and of blunders."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from calibration.estimate import ParameterEstimate
from calibration.observability import Observability
from carosac_toolkit.reports.page import (
    bullets,
    definitions,
    made_with,
    page,
    picture,
    repeat,
    table,
    warnings,
    write_files,
)
from carosac_toolkit.text_tables import Rows, fit, terminal_width, wrapped

PARAMETER_HEADER = (
    "parameter", "unit", "before", "known to", "after", "1 sigma", "moved by", "in sigmas before",
)  # fmt: skip
PARAMETER_GROUPS = (2, 2, 2, 2)
_UNITS_SHOWN = {"m": ("mm", 1e3), "s": ("ms", 1e3), "rad": ("mrad", 1e3)}  # of what is small
_SHOWN_IN_MM = ("exit_points", "anchor_points", "drum_radius", "center_of_mass", "run_length")


def parameter_rows(estimate: ParameterEstimate) -> Rows:
    """One row for each parameter, with as many digits as its sigma carries."""
    rows: Rows = []
    for name, unit, start, prior, value, sigma in zip(
        estimate.names, estimate.units, estimate.start, estimate.prior_sigma, estimate.value,
        estimate.sigma, strict=True,
    ):  # fmt: skip
        word, factor = (
            ("mm", 1e3) if name.startswith(_SHOWN_IN_MM) else _UNITS_SHOWN.get(unit, (unit, 1.0))
        )
        digits = _digits(sigma * factor)
        moved = value - start
        rows.append(
            (
                name,
                word,
                f"{start * factor:.{digits}f}",
                f"{prior * factor:.2g}" if np.isfinite(prior) else "nothing",
                f"{value * factor:.{digits}f}",
                f"{sigma * factor:.2g}",
                f"{moved * factor:+.{digits}f}",
                f"{abs(moved) / prior:.1f}" if np.isfinite(prior) else "-",
            )
        )
    return rows


def _digits(sigma: float) -> int:
    """Decimals that show two digits of a sigma."""
    if sigma <= 0.0:
        return 6
    return int(np.clip(1 - np.floor(np.log10(sigma)), 0, 9))


def print_parameters(estimate: ParameterEstimate) -> None:
    """Print the table of parameters within the width of the terminal."""
    print(fit(PARAMETER_HEADER, parameter_rows(estimate), PARAMETER_GROUPS, terminal_width()))


def print_sentences(lines: Sequence[str], start: str = "* ") -> None:
    """Print sentences, each with a mark in front, broken between words."""
    for line in lines:
        print(wrapped(line, terminal_width(), start))


def parameters_html(estimate: ParameterEstimate) -> str:
    """The table of parameters."""
    return (
        "<h2>Parameters</h2><p>Known to: one standard deviation before the calibration. 1 sigma: "
        "one standard deviation after it, what was known before included.</p>"
        + table(PARAMETER_HEADER, parameter_rows(estimate), left=2)
    )


def observability_html(observability: Observability) -> str:
    """What the data can tell and what not."""
    return "<h2>What the data can tell</h2>" + bullets(observability.sentences())


def blunders_html(header: tuple[str, ...], rows: Rows, *, left: int) -> str:
    """The table of measurements that were left out, or the sentence that there are none."""
    found = table(header, rows, left=left) if rows else "<p>None.</p>"
    return f"<h2>Measurements left out as blunders</h2>{found}"


def write_report(
    folder: Path,
    title: str,
    parts: Sequence[str],
    *,
    said: Sequence[str] = (),
    warned: Sequence[str] = (),
    images: Mapping[str, tuple[bytes, str]],
    provenance: Mapping[str, str],
    words: Sequence[str],
) -> list[Path]:
    """Write report.html and its pictures into a folder; every file appears whole, or nothing does.

    Args:
        folder: Made if need be; files of an earlier report in it are replaced.
        title: Of the page.
        parts: HTML, in order.
        said: What was found, in sentences.
        warned: What must not be overlooked.
        images: PNG and caption by file name without suffix.
        provenance: What went in.
        words: The command that repeats this.

    Returns:
        The files, the report last.
    """
    document = page(
        title,
        [
            *warnings(warned),
            bullets(said),
            *parts,
            *(picture(image, caption) for image, caption in images.values()),
            "<h2>Provenance</h2>",
            definitions({**provenance, **made_with()}),
            repeat(words),
        ],
    )
    files = {f"{name}.png": image for name, (image, _) in images.items()}
    return write_files(folder, {**files, "report.html": document.encode()})
