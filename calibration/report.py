"""Reports, tables and command words that all calibrations share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from calibration.estimate import ParameterEstimate
from calibration.observability import Observability
from calibration.result import CalibrationResult
from calibration.robot_update import write_robot
from carosac_toolkit.base.numbers import plain
from carosac_toolkit.base.tables import Rows, fit, terminal_width, wrapped
from carosac_toolkit.pictures.saving import picture_files
from carosac_toolkit.reports.page import (
    bullets,
    definitions,
    made_with,
    page,
    pictures,
    repeat,
    table,
    warnings,
    write_files,
)
from carosac_toolkit.robot.model_error import ModelError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PARAMETER_HEADER = (
    "parameter", "unit", "before", "known to", "after", "1 sigma", "moved by", "in sigmas before",
)  # fmt: skip
PARAMETER_GROUPS = (2, 2, 2, 2)
_UNITS_SHOWN = {"m": ("mm", 1e3), "s": ("ms", 1e3), "rad": ("mrad", 1e3)}  # of what is small
_SHOWN_IN_MM = ("exit_points", "anchor_points", "drum_radius", "center_of_mass", "run_length")


def parameter_rows(estimate: ParameterEstimate) -> Rows:
    """Return one row for each parameter, with as many digits as its sigma carries."""
    rows: Rows = []
    for name, unit, start, prior, value, sigma, moved in zip(
        estimate.names, estimate.units, estimate.start, estimate.prior_sigma, estimate.value,
        estimate.sigma, estimate.moved, strict=True,
    ):  # fmt: skip
        word, factor = (
            ("mm", 1e3) if name.startswith(_SHOWN_IN_MM) else _UNITS_SHOWN.get(unit, (unit, 1.0))
        )
        digits = _digits(sigma * factor)
        rows.append(
            (
                name,
                word,
                f"{start * factor:.{digits}f}",
                plain(prior * factor, 2) if np.isfinite(prior) else "nothing",
                f"{value * factor:.{digits}f}",
                plain(sigma * factor, 2),
                f"{(value - start) * factor:+.{digits}f}",
                f"{abs(moved):.1f}" if np.isfinite(prior) else "-",
            )
        )
    return rows


def _digits(sigma: float) -> int:
    """Return the decimals that show two digits of a sigma."""
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
    """Return the table of parameters."""
    return (
        "<h2>Parameters</h2><p>Known to: one standard deviation before the calibration. 1 sigma: "
        "one standard deviation after it, what was known before included.</p>"
        + table(PARAMETER_HEADER, parameter_rows(estimate), left=2)
    )


def observability_html(observability: Observability) -> str:
    """Return what the data can tell and what not."""
    return "<h2>What the data can tell</h2>" + bullets(observability.sentences())


def blunders_html(header: tuple[str, ...], rows: Rows, *, left: int) -> str:
    """Return the table of measurements that were left out, or the sentence that there are none."""
    content = table(header, rows, left=left) if rows else "<p>None.</p>"
    return f"<h2>Measurements left out as blunders</h2>{content}"


@dataclass(frozen=True, kw_only=True)
class ReportContent:
    """The part of a report that differs from calibration to calibration.

    Attributes:
        parts: HTML, in order.
        images: Figure and caption by file name without suffix.
    """

    parts: Sequence[str]
    images: Mapping[str, tuple[Figure, str]]


def write_report(
    folder: Path,
    title: str,
    result: CalibrationResult,
    content: ReportContent,
    *,
    provenance: Mapping[str, str],
    command: Sequence[str],
) -> list[Path]:
    """Write report.html and its pictures into a folder; every file appears whole, or nothing does.

    Args:
        folder: Made if need be; files of an earlier report in it are replaced.
        title: Of the page.
        result: Its sentences and warnings stand on top.
        content: Tables and pictures.
        provenance: Inputs by name.
        command: The command that repeats the calibration.

    Returns:
        The files, the report last.
    """
    files = picture_files({name: figure for name, (figure, _) in content.images.items()})
    captions = {name: caption for name, (_, caption) in content.images.items()}
    document = page(
        title,
        [
            *warnings(result.warnings),
            bullets(result.sentences()),
            *content.parts,
            *pictures(files, captions),
            "<h2>Provenance</h2>",
            definitions({**provenance, **made_with()}),
            repeat(command),
        ],
    )
    return write_files(folder, {**files, "report.html": document.encode()})


def write_new_robot(
    result: CalibrationResult, robot: str, output: Path | None, *, provenance: str,
    name: str | None = None, model_error: ModelError | None = None,
) -> None:  # fmt: skip
    """Write the calibrated robot's file, if one was asked for, and print where it is.

    Args:
        result: The calibration.
        robot: Bundled name or path of the robot before.
        output: The new file; None: nothing is written.
        provenance: Source of the numbers, one line.
        name: Of the new robot; None keeps the old one.
        model_error: What the model with the new numbers misses; None: not known.
    """
    if output is not None:
        write_robot(
            robot, result.robot_estimate, output, provenance=provenance, name=name,
            model_error=model_error,
        )  # fmt: skip
        print(f"\nnew robot file: {output}")


def option_words(options: object, skipped: Sequence[str]) -> list[str]:
    """Return the words of a command line that set options to other than their defaults.

    Args:
        options: A dataclass of options.
        skipped: Options that stand elsewhere in the command.
    """
    words: list[str] = []
    for field in fields(options):  # type: ignore[arg-type]
        value = getattr(options, field.name)
        if field.name not in skipped and value != field.default:
            words += [f"--{field.name.replace('_', '-')}", *([] if value is True else [str(value)])]
    return words
