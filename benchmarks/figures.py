"""Figures that README and docs cite: read from RESULTS.md, kept in results.json, held in the prose.

``python -m benchmarks.figures`` lists what disagrees, with exit status 1; ``--write`` corrects
``results.json`` and the prose. ``figures.toml`` says in which row and column of RESULTS.md each
figure stands. Benchmarks call `refresh_values` whenever they write a section.

A comment behind numbers in Markdown names their figures, one number for each value. In a table one
comment at the end of a row is enough::

    tracks with 0.28 <!-- figure: policies.realtime.ratio.policy --> of the error
    30.7 / 10.7 / 11.7 mm <!-- figure: core.kinematic_solver.scampi.ours[0:3] -->
    under 0.1 µm <!-- figure: <simulator.rest.slack*1000 -->
    about 30 µs <!-- figure: ~statics.fk.carosac -->

``[i]`` and ``[i:j]`` pick from several values, ``*1000`` changes the unit, ``~`` rounds to one
significant digit and ``<`` marks a bound, which has to hold. ``<!-- source: TEXT -->`` gives the
source of all numbers before it in its table cell: a test, as ``tests/test_x.py::test_name``, or
words.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from decimal import ROUND_HALF_UP, ROUND_UP, Decimal
from pathlib import Path

FOLDER = Path(__file__).parent
ROOT = FOLDER.parent
RESULTS = FOLDER / "RESULTS.md"
CATALOGUE = FOLDER / "figures.toml"
VALUES = FOLDER / "results.json"
PAGES = (ROOT / "README.md", ROOT / "CHANGELOG.md", *sorted((ROOT / "docs").glob("*.md")))

SECTION = re.compile(
    r"<!-- (?P<key>\S+) -->\n## .*\n\n"
    r"`(?P<command>.+)`, (?P<date>\d{4}-\d\d-\d\d), (?P<machine>.+)\.\n\n"
    r"(?P<body>(?:.*\n)*?)<!-- end (?P=key) -->"
)
RESULT_NUMBER = re.compile(r"(?<![\w.])-?\d+(?:,\d{3})*(?:\.\d+)?(?:e[+-]?\d+)?")
PROSE_NUMBER = re.compile(
    r"(?<![\w.-])-?(?:\d{1,3}(?: \d{3})+|\d+)(?:\.\d+)?(?:e[+-]?\d+)?(?![\d.]*\d)"
)
MARKER = re.compile(r"\s*<!-- (?P<kind>figure|source): (?P<text>.+?) -->", re.DOTALL)
CITATION = re.compile(
    r"(?P<sign>[~<]?)(?P<id>[\w.-]+)(?:\[(?P<start>\d+)(?::(?P<stop>\d+))?\])?(?:\*(?P<scale>[\d.]+))?"
)


@dataclass(frozen=True, kw_only=True)
class Citation:
    """Number in prose beside the value that it stands for.

    Attributes:
        place: Page and line.
        figure: Id of the figure, or its source in words.
        start: Index of the number's first character in the page.
        shown: Number as the page has it.
        expected: Number as it should be, to the digits shown.
    """

    place: str
    figure: str
    start: int
    shown: str
    expected: str


def tables(body: str) -> Iterator[tuple[list[str], list[list[str]]]]:
    """Yield header and rows of each Markdown table."""
    for block in re.findall(r"(?:^\|.*\n)+", body + "\n", re.MULTILINE):
        header, _, *rows = [
            [cell.replace("\\|", "|").strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]]
            for line in block.splitlines()
        ]
        yield header, rows


def find_cell(body: str, row: str, column: str) -> str:
    """Return the cell of the row that begins with the given cells.

    Raises:
        LookupError: There is none, or there are several that differ.
    """
    start = row.split(" | ")
    cells = {
        cells[header.index(column)]
        for header, rows in tables(body) if column in header
        for cells in rows if cells[: len(start)] == start
    }  # fmt: skip
    if len(cells) != 1:
        raise LookupError(f"{len(cells)} cells in row '{row}', column '{column}'")
    return cells.pop()


def figure_of(cell: str, column: str) -> dict[str, object]:
    """Return value, or values, and unit of a cell.

    Raises:
        LookupError: The cell has no number.
    """
    numbers = [float(n.replace(",", "")) for n in RESULT_NUMBER.findall(cell)]
    if not numbers:
        raise LookupError(f"no number in '{cell}'")
    unit = re.search(r"\[(.+)\]", column) or re.search(r"\d ?([a-zA-Z%]+)\W*$", cell)
    return {"value": numbers if len(numbers) > 1 else numbers[0], "unit": unit[1] if unit else ""}


def read_values(results: str, catalogue: str) -> tuple[dict[str, dict[str, object]], list[str]]:
    """Read the catalogue's figures from the text of RESULTS.md.

    Returns:
        Sections with their figures, as results.json has them, and what was not found.
    """
    sections = {match["key"]: match for match in SECTION.finditer(results)}
    values: dict[str, dict[str, object]] = {}
    missing = []
    for group, entry in tomllib.loads(catalogue).items():
        section = sections.get(entry["section"])
        if section is None:
            missing.append(f"{group}: RESULTS.md has no section '{entry['section']}'")
            continue
        columns = entry["columns"] if "columns" in entry else {"": entry["column"]}
        stamp = {name: section[name] for name in ("command", "date", "machine")}
        figures = values.setdefault(section["key"], {**stamp, "figures": {}})["figures"]
        assert isinstance(figures, dict)
        for name, row in entry["rows"].items():
            for suffix, column in columns.items():
                figure = ".".join(filter(None, (group, name, suffix)))
                try:
                    value = figure_of(find_cell(section["body"], row, column), column)
                    figures[figure] = {**value, "protocol": entry["protocol"]}
                except LookupError as error:
                    missing.append(f"{figure}: section '{section['key']}' has {error}")
    return values, missing


def refresh_values() -> list[str]:
    """Write results.json from RESULTS.md; return what the catalogue names in vain."""
    values, missing = read_values(
        RESULTS.read_text(encoding="utf-8"), CATALOGUE.read_text(encoding="utf-8")
    )
    VALUES.write_text(json.dumps(values, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    return missing


def load_figures() -> dict[str, list[float]]:
    """Return the values of each figure of results.json."""
    sections = json.loads(VALUES.read_text(encoding="utf-8"))
    figures = {}
    for section in sections.values():
        for name, figure in section["figures"].items():
            value = figure["value"]
            figures[name] = value if isinstance(value, list) else [value]
    return figures


def cited_values(text: str, figures: dict[str, list[float]]) -> list[tuple[str, str, float]]:
    """Return sign, id and value of each number that a comment speaks for.

    Raises:
        LookupError: A word of the comment is no figure.
    """
    values = []
    for word in text.split():
        match = CITATION.fullmatch(word)
        if match is None or match["id"] not in figures:
            raise LookupError(
                f"results.json has no figure '{word}': add its row to benchmarks/figures.toml, "
                "then run python -m benchmarks.figures --write"
            )
        start, stop = match["start"], match["stop"]
        first = int(start or 0)
        last = int(stop) if stop else first + 1 if start else None
        chosen = figures[match["id"]][first:last]
        if not chosen:
            raise LookupError(f"figure '{match['id']}' has fewer values than '{word}' wants")
        scale = float(match["scale"] or 1)
        values += [(match["sign"], match["id"], value * scale) for value in chosen]
    return values


def format_like(shown: str, sign: str, value: float) -> str:
    """Format a value with the digits of a number in prose; a bound that holds stays as it is."""
    exact = Decimal(f"{value:.12g}")
    plain = shown.replace(" ", "")
    if sign == "<" and exact <= Decimal(plain):
        return shown
    mantissa = re.split("e", plain)[0]
    places = len(mantissa.partition(".")[2])
    if "e" in plain or sign == "~":
        exponent = exact.adjusted()
        places = places - exponent if "e" in plain else -exponent
    rounding = ROUND_UP if sign == "<" else ROUND_HALF_UP
    digits = exact.quantize(Decimal(1).scaleb(-places), rounding)
    if "e" in plain:
        return f"{digits:.{len(mantissa.partition('.')[2])}e}".replace("e+", "e")
    return f"{digits:,f}".replace(",", " ") if " " in shown else f"{digits:f}"


def read_page(
    text: str, name: str, figures: dict[str, list[float]]
) -> tuple[list[Citation], list[str]]:
    """Return the numbers of a page that have a figure or a source, and comments that are wrong."""
    citations, faults = [], []
    end = 0
    for marker in MARKER.finditer(text):
        line = text.rfind("\n", 0, marker.start()) + 1
        of_source = marker["kind"] == "source"
        paragraph = "\n" if text.startswith("|", line) else "\n\n"
        border = text.rfind("|" if of_source else paragraph, 0, marker.start())
        numbers = list(PROSE_NUMBER.finditer(text, max(end, border + 1), marker.start()))
        end = marker.end()
        place = f"{name}:{text.count(chr(10), 0, marker.start()) + 1}"
        if of_source:
            faults += [f"{place}: {fault}" for fault in source_faults(marker["text"])]
            citations += [
                Citation(
                    place=place, figure=marker["text"], start=n.start(), shown=n[0], expected=n[0]
                )
                for n in numbers
            ]
            continue
        try:
            values = cited_values(marker["text"], figures)
        except LookupError as error:
            faults.append(f"{place}: {error}")
            continue
        if len(values) > len(numbers):
            faults.append(f"{place}: {len(values)} values for {len(numbers)} numbers before them")
            continue
        for number, (sign, figure, value) in zip(numbers[-len(values) :], values, strict=True):
            citations.append(
                Citation(
                    place=place, figure=figure, start=number.start(), shown=number[0],
                    expected=format_like(number[0], sign, value),
                )
            )  # fmt: skip
    return citations, faults


def source_faults(text: str) -> list[str]:
    """Return what is wrong with a source that names a test; others are words."""
    path, colons, test = text.partition("::")
    if not colons:
        return []
    file = ROOT / path
    if not file.is_file() or f"def {test}(" not in file.read_text(encoding="utf-8"):
        return [f"there is no test '{text}'"]
    return []


def corrected(text: str, citations: list[Citation]) -> str:
    """Return a page with each cited number as it should be."""
    for citation in sorted(citations, key=lambda c: -c.start):
        end = citation.start + len(citation.shown)
        text = text[: citation.start] + citation.expected + text[end:]
    return text


def main() -> int:
    """Check, or correct, results.json and the prose."""
    parser = argparse.ArgumentParser(
        description="Compare README and docs with benchmarks/results.json."
    )
    parser.add_argument("--write", action="store_true", help="correct results.json and the prose")
    write = parser.parse_args().write
    faults = refresh_values() if write else []
    figures = load_figures()
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        citations, wrong = read_page(text, str(page.relative_to(ROOT)), figures)
        faults += wrong
        for citation in citations:
            if citation.shown != citation.expected:
                change = f"{citation.shown} -> {citation.expected} ({citation.figure})"
                print(f"{citation.place}: {change}")
                faults += [] if write else [f"{citation.place}: {change}"]
        if write:
            page.write_text(corrected(text, citations), encoding="utf-8")
    for fault in faults:
        print(fault, file=sys.stderr)
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
