"""Paired statistics as tables for a paper: Markdown and LaTeX, and text for the terminal."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from math import floor, isfinite, log10

from carosac_toolkit.base.tables import counted, fit, wrapped
from carosac_toolkit.studies.compare.paired import SIGNIFICANCE_LEVEL, Compared, PairedBlock
from carosac_toolkit.studies.compare.pairs import IntervalEstimate, Pair
from carosac_toolkit.studies.compare.resampling import (
    CONFIDENCE_LEVEL,
    INTERVAL_SEEDS_MIN,
    smallest_p,
)
from carosac_toolkit.studies.compare.results import COMPARED_COLUMNS
from carosac_toolkit.studies.compare.terminal_table import after_the_end
from carosac_toolkit.studies.run.rows import LATENCY_COLUMNS

QUANTITY_TITLES = {
    "tracking": "tracking",
    "tracking_centre": "centre",
    "tracking_boundary": "boundary",
    "residual_sway": "sway",
    "estimation": "estimation",
}
TERMINAL_QUANTITIES = ("tracking", "estimation")  # in the terminal
MM_PER_M = 1e3
DECIMALS_MAX = 2
SIGNIFICANT_DIGITS = (
    3  # significant ones of the smallest number of a column, where it is not below them
)
P_VALUE_SHOWN_MIN = 1e-3


@dataclass(frozen=True, kw_only=True)
class Sheet:
    """Table of cells as text without any mark-up.

    Attributes:
        title: Subject of the table.
        header: Column titles, with units.
        rows: Cells.
        left: Columns on the left that hold names.
        bold: Row and column of cells that stand out.
    """

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    left: int
    bold: frozenset[tuple[int, int]] = frozenset()


def sheets(blocks: Sequence[PairedBlock]) -> list[Sheet]:
    """Return all tables of a study: errors of each block, and its paired differences."""
    tables = []
    for block in blocks:
        tables.append(_errors(block))
        if differing(block):
            tables.append(_differences(block))
    return tables


def explanation(blocks: Sequence[PairedBlock]) -> str:
    """Explain the columns of all tables."""
    percent = f"{100 * CONFIDENCE_LEVEL:.0f} %"
    seeds = min(block.seeds for block in blocks)
    text = (
        "Errors are RMSEs of a case in norm. Typical: median over the seeds of each path, mean "
        f"over the paths; in brackets its {percent} interval. Sway is the RMS swing "
        f"{after_the_end(block.final_rest for block in blocks)}. Centre: the reference is in "
        "the middle half of each side of the workspace box; boundary: it is not. Latency is that "
        "of estimator and controller, per cycle: median over the cases of median, 95th and 99th "
        "percentile. Differences are paired: same plant, path and noise, minus the baseline, over "
        "the cases that both solved; ratio: of the typical errors in the same cases. Won: cases "
        "with the smaller error; a case that failed is lost. Intervals: cluster bootstrap over "
        "the seeds, expanded percentiles. p: two-sided, of cases won against lost, paired "
        "permutation test over seeds, Holm-corrected for all comparisons of the same error in a "
        "table. Bold: smallest, and better than each of the others: all intervals of its paired "
        "differences exclude zero, and the corrected p is "
        f"at most {SIGNIFICANCE_LEVEL:g}."
    )
    if seeds < INTERVAL_SEEDS_MIN:
        text += f" Intervals need {INTERVAL_SEEDS_MIN} seeds or more; here are {seeds}."
    lowest, fewest, others = max(
        (_lowest_p(block), block.seeds, _others(block)) for block in blocks
    )
    if lowest > SIGNIFICANCE_LEVEL:
        text += (
            f" With {counted(fewest, 'seed')} and {counted(others, 'comparison')} no corrected p "
            f"is below {lowest:.2g}: nothing can be significant at the level "
            f"{SIGNIFICANCE_LEVEL:g}."
        )
    return text


def _others(block: PairedBlock) -> int:
    """Return how many groups are compared with the baseline."""
    return max(len(block.compared) - 1, 1)


def _lowest_p(block: PairedBlock) -> float:
    """Return the smallest p that a comparison can have, Holm-corrected."""
    return min(1.0, _others(block) * smallest_p(block.seeds))


def text_tables(blocks: Sequence[PairedBlock], width: int, *, before: str = "") -> str:
    """Format the paired differences of tracking and estimation within a width.

    Args:
        blocks: One table each.
        width: Of the terminal, in characters.
        before: What stands before each title.
    """
    parts = []
    for block in blocks:
        if any(name in differing(block) for name in TERMINAL_QUANTITIES):
            sheet = _differences(block, TERMINAL_QUANTITIES)
            parts.append(
                wrapped(f"{before}Paired, {sheet.title}", width) + f"\n\n{_text(sheet, width)}"
            )
    return "\n\n".join(parts)


def text_errors(blocks: Sequence[PairedBlock], width: int) -> str:
    """Format the typical errors within a width."""
    tables = [_errors(block) for block in blocks]
    return "\n\n".join(f"{wrapped(one.title, width)}\n\n{_text(one, width)}" for one in tables)


def differing(block: PairedBlock) -> list[str]:
    """Return the errors in which any group differs from the baseline."""
    return [
        name for name in QUANTITY_TITLES
        if any(
            (pair := one.pairs.get(name)) is not None and (pair.won or pair.lost)
            for one in block.compared
        )
    ]  # fmt: skip


def _text(sheet: Sheet, width: int) -> str:
    """Format one table within a width."""
    groups = (sheet.left, *[1] * (len(sheet.header) - sheet.left))
    return fit(sheet.header, list(sheet.rows), groups, width)


def markdown(blocks: Sequence[PairedBlock], origin: str = "") -> str:
    """Return all tables as Markdown.

    Args:
        blocks: Blocks of the study.
        origin: Origin of the numbers, as a last paragraph.
    """
    parts = [f"**{sheet.title}**\n\n{markdown_table(sheet)}" for sheet in sheets(blocks)]
    return "\n\n".join(filter(None, [*parts, explanation(blocks), origin])) + "\n"


def latex(blocks: Sequence[PairedBlock], origin: str = "") -> str:
    r"""Return all tables as LaTeX, to be read with ``\input``; they need the package booktabs.

    Args:
        blocks: Blocks of the study.
        origin: Origin of the numbers, as a comment.
    """
    head = ["% \\usepackage{booktabs}", *(f"% {line}" for line in origin.splitlines())]
    notes = f"% {explanation(blocks)}"
    return "\n\n".join(["\n".join([*head, notes]), *map(_latex_table, sheets(blocks))]) + "\n"


def _errors(block: PairedBlock) -> Sheet:
    """Return the table of typical errors and latencies."""
    names = _names(block)
    errors = [
        name for name in QUANTITY_TITLES if any(name in one.typical for one in block.compared)
    ]
    rows, bold = [], set()
    places = {name: _decimals([_value(one, name) for one in block.compared]) for name in errors}
    for k, one in enumerate(block.compared):
        cells = [_estimate(one.typical.get(name), MM_PER_M, places[name]) for name in errors]
        latency = " / ".join(_milliseconds(one.latency[name]) for name in LATENCY_COLUMNS)
        known = [one.names[name] for name in names]
        rows.append((*known, *cells, f"{one.failures}/{one.cases}", latency))
        bold |= {(k, len(names) + errors.index(name)) for name in one.best}
    titles = [f"{QUANTITY_TITLES[name]} [mm]" for name in errors]
    header = (*names, *titles, "failed", "latency 50/95/99 % [ms]")
    title = f"{_where(block)}: typical errors"
    return Sheet(
        title=title, header=header, rows=tuple(rows), left=len(names), bold=frozenset(bold)
    )


def _differences(block: PairedBlock, wanted: Sequence[str] = tuple(QUANTITY_TITLES)) -> Sheet:
    """Return the table of paired differences with the baseline."""
    names, rows = _names(block), []
    errors = [name for name in wanted if name in differing(block)]
    for name in errors:
        pairs = [(one, one.pairs[name]) for one in block.compared if name in one.pairs]
        places = _decimals(
            [
                abs(pair.difference.value) * MM_PER_M
                for _, pair in pairs
                if pair.difference is not None
            ]
        )
        rows += [
            (QUANTITY_TITLES[name], *(one.names[x] for x in names), *_pair(pair, places))
            for one, pair in pairs
        ]
    header = ("error", *names, "difference [mm]", "ratio [-]", "won", "p", "failed")
    title = f"{_where(block)}: against {block.baseline}"
    return Sheet(title=title, header=header, rows=tuple(rows), left=1 + len(names))


def _pair(pair: Pair, places: int) -> tuple[str, ...]:
    """Return the cells of a comparison."""
    return (
        _estimate(pair.difference, MM_PER_M, places, signed=True),
        _estimate(pair.ratio, 1.0, 2),
        f"{pair.won}/{pair.cases}",
        _p(pair.p_holm),
        f"{pair.failed[0]}, {pair.failed[1]}",
    )


def _where(block: PairedBlock) -> str:
    """Name the robot and condition of a table."""
    draws = f"{counted(block.seeds, 'seed')} x {counted(block.trajectories, 'path')}"
    return f"{block.robot_name}, condition {block.perturbation}, {draws}"


def _names(block: PairedBlock) -> list[str]:
    """Return the names that distinguish the groups of a block."""
    varies = [n for n in COMPARED_COLUMNS if len({one.names[n] for one in block.compared}) > 1]
    return varies or ["controller"]


def _value(one: Compared, name: str) -> float:
    """Return a typical error in mm; not finite if there is none."""
    return MM_PER_M * one.typical[name].value if name in one.typical else float("nan")


def _decimals(values: Sequence[float]) -> int:
    """Return the number of decimals of a column, the same for all its cells."""
    known = [abs(value) for value in values if isfinite(value) and value != 0.0]
    if not known:
        return 1
    return min(DECIMALS_MAX, max(0, SIGNIFICANT_DIGITS - 1 - floor(log10(min(known)))))


def _estimate(
    one: IntervalEstimate | None, factor: float, places: int, *, signed: bool = False
) -> str:
    """Format a number with its interval."""
    if one is None:
        return "-"
    sign = "+" if signed else ""
    text = f"{factor * one.value:{sign}.{places}f}"
    if one.low is None or one.high is None:
        return text
    low, high = (f"{factor * end:{sign}.{places}f}" for end in (one.low, one.high))
    return f"{text} ({low}, {high})"


def _p(value: float | None) -> str:
    """Format a p; a small one as a bound."""
    if value is None:
        return "-"
    return f"<{P_VALUE_SHOWN_MIN:g}" if value < P_VALUE_SHOWN_MIN else f"{value:.3f}"


def _milliseconds(value: float | None) -> str:
    return "-" if value is None else f"{1e3 * value:.2f}"


def markdown_table(sheet: Sheet) -> str:
    """Return one table as Markdown."""
    lines = [
        f"| {' | '.join(sheet.header)} |",
        "|" + "---|" * sheet.left + "---:|" * (len(sheet.header) - sheet.left),
    ]
    for k, row in enumerate(sheet.rows):
        cells = [f"**{text}**" if (k, i) in sheet.bold else text for i, text in enumerate(row)]
        lines.append(f"| {' | '.join(text.replace('|', '&#124;') for text in cells)} |")
    return "\n".join(lines)


def _latex_table(sheet: Sheet) -> str:
    """Return one table as LaTeX."""
    columns = "l" * sheet.left + "r" * (len(sheet.header) - sheet.left)
    body = []
    for k, row in enumerate(sheet.rows):
        cells = [_latex_cell(text, (k, i) in sheet.bold) for i, text in enumerate(row)]
        body.append(" & ".join(cells) + r" \\")
    titles = " & ".join(_latex_cell(text) for text in sheet.header)
    return "\n".join([
        r"\begin{table}", r"  \centering", rf"  \caption{{{_latex_cell(sheet.title)}}}",
        rf"  \begin{{tabular}}{{{columns}}}", r"    \toprule", rf"    {titles} \\",
        r"    \midrule", *(f"    {line}" for line in body), r"    \bottomrule",
        r"  \end{tabular}", r"\end{table}",
    ])  # fmt: skip


_LATEX_ESCAPES = {
    "\\": r"\textbackslash{}", "_": r"\_", "%": r"\%", "&": r"\&", "#": r"\#", "$": r"\$",
    "{": r"\{", "}": r"\}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}",
    "<": "$<$", ">": "$>$", "\u00b1": r"$\pm$",
}  # fmt: skip


_SIGNED_NUMBER_PATTERN = re.compile(r"(?<![\w.])([+-]\d[\d.]*)")


def _latex_cell(text: str, bold: bool = False) -> str:
    """Return text for LaTeX: special characters escaped, numbers with a true minus sign."""
    done = "".join(_LATEX_ESCAPES.get(character, character) for character in text)
    done = _SIGNED_NUMBER_PATTERN.sub(r"$\1$", done)
    return rf"\textbf{{{done}}}" if bold else done
