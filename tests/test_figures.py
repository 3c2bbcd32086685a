"""Figures in README and docs are those of benchmarks/results.json, and those are of RESULTS.md."""

from __future__ import annotations

import itertools
import json
import re
import tomllib
from collections.abc import Iterator

import pytest

from benchmarks import figures, results
from benchmarks.figures import CATALOGUE, MARKER, PAGES, PROSE_NUMBER, RESULTS, ROOT, VALUES

# Headers of tables whose numbers are settings, formats, codes, methods or bounds: nobody measured
# them. A table with numbers is either one of these, or its numbers have figures or sources.
NOT_MEASURED = {
    "| I want to | Read |",
    "| Term | In code | Meaning, unit, frame |",
    "| `cables` | what | use it for |",
    "| `distribution` | tensions | for |",
    "| `sighted` | the point | what must be known |",
    "| column | meaning |",
    "| column | what |",
    "| command | port | opened on | who is served |",
    "| exit status | meaning |",
    "| file | limit |",
    "| line | what happens |",
    "| If you need | Use | Because this toolkit |",
    "| material | density [g/cm³] | E of wire or fibre [GPa] | c | EA of a rope of 10 g/m [kN] |",
    "| name | cables | robot |",
    "| number | fault | |",
    "| number | state | |",
    "| number | value to begin with | why |",
    "| number | how |",
    "| option | does |",
    "| package | used for |",
    "| parameter | known to, where the robot file says nothing |",
    "| parameter | prior, one standard deviation | option |",
    "| protocol | paths | what |",
    "| ratio | of | on `carosac` |",
    "| request | what the PLC does | refused where |",
    "| sensor | in suites | rate | noise | bias | delay |",
    "| silence that counts as lost | PLC | emulated PLC | why |",
    "| step | file | the length is called |",
    "| subpackage | what lives there |",
    "| symbol | type | who writes | how often |",
    "| tool | language, licence | takes you further than this toolkit in | has not |",
    "| what you have | tool | what it finds |",
    "| what | bound | the authors' compiled solver |",
    "| what | files |",
    "| what | on what | error allowed |",
    "| what | one standard deviation in `nominal-1`, and in `nominal-2` on `carosac` "
    "| in `nominal-2` on any robot |",
    "| what | what happens | counted in `belief.memory` |",
    "| what | why | what it needs |",
    "| world | what a step is |",
    "| | CASPR | WireX | cdpyr |",
    "| | |",
}
WORDS = re.compile(r"`[^`]*`|\]\([^)]*\)|<!--.*?-->")  # code, addresses of links, comments
FIGURES = {"speed.fk": [34.4], "error.axes": [20.55, 10.4, 11.5], "share": [9.9e-11]}


def tables_of(text: str) -> Iterator[tuple[str, list[tuple[int, str]]]]:
    """Header of each table outside of code, and its rows with their places in the page."""
    code = re.sub(r"^```.*?^```", lambda m: re.sub(r"[^\n]", " ", m[0]), text, flags=re.M | re.S)
    for block in re.finditer(r"(?:^\|.*\n)+", code, re.MULTILINE):
        header, _, *rows = re.finditer(r".+", block[0])
        yield header[0], [(block.start() + row.start(), row[0]) for row in rows]


def cells_of(start: int, row: str) -> list[list[int]]:
    """Places in the page of the numbers in each cell of a row."""
    plain = WORDS.sub(lambda m: " " * len(m[0]), row)
    borders = [m.start() for m in re.finditer(r"\|", plain)]
    numbers = [m.start() for m in PROSE_NUMBER.finditer(plain)]
    return [
        [start + n for n in numbers if left < n < right]
        for left, right in itertools.pairwise(borders)
    ]


def unsourced(text: str) -> list[str]:
    """Rows of results tables with a number in a measured column that nothing stands behind."""
    citations, _ = figures.read_page(text, "page", figures.load_figures())
    known = {citation.start for citation in citations}
    missing = []
    for header, rows in tables_of(text):
        cells = [cells_of(start, row) for start, row in rows]
        measured = {k for row in cells for k, at in enumerate(row) if k and known.intersection(at)}
        bare = [any(set(row[k]) - known for k in measured) for row in cells]
        if measured:
            missing += [row for (_, row), at_fault in zip(rows, bare, strict=True) if at_fault]
        elif header not in NOT_MEASURED and any(any(row) for row in cells):
            missing.append(header)
    return missing


def test_results_json_has_the_figures_of_results_md():
    values, missing = figures.read_values(RESULTS.read_text("utf-8"), CATALOGUE.read_text("utf-8"))
    assert missing == []
    assert json.loads(VALUES.read_text("utf-8")) == values, "python -m benchmarks.figures --write"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_numbers_in_the_prose_are_those_of_the_results(page):
    name = str(page.relative_to(ROOT))
    citations, faults = figures.read_page(page.read_text("utf-8"), name, figures.load_figures())
    wrong = [c for c in citations if c.shown != c.expected]
    assert (faults, wrong) == ([], []), "python -m benchmarks.figures --write"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_every_number_in_a_table_of_results_has_a_source(page):
    assert unsourced(page.read_text("utf-8")) == [], (
        "a column with one cited number is measured: each number in it needs a comment with its "
        "figure or source, see benchmarks/figures.py"
    )


def test_every_group_of_the_catalogue_is_cited():
    text = "".join(page.read_text("utf-8") for page in PAGES)
    cited = {word for marker in MARKER.finditer(text) for word in marker["text"].split()}
    groups = tomllib.loads(CATALOGUE.read_text("utf-8"))
    assert [g for g in groups if not any(c.lstrip("~<").startswith(g) for c in cited)] == []


def test_the_docs_say_which_learning_figure_they_mean():
    text = "".join(page.read_text("utf-8") for page in PAGES)
    ratios = re.findall(r"(\S+) -->\s+of the\s+error of catenary inverse kinematics", text)
    assert set(ratios) == {"policies.realtime.ratio.policy"}


def test_a_table_without_sources_is_noticed():
    bare = "| model | error |\n|---|---|\n| ours | 3 mm |\n"
    assert unsourced(bare) == ["| model | error |"]
    row = "| ours | 34 mm <!-- figure: statics.fk.carosac --> |\n"
    assert unsourced(bare.replace("| ours | 3 mm |\n", row + "| theirs | 5 mm |\n")) == [
        "| theirs | 5 mm |"
    ]


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("34 µs <!-- figure: speed.fk -->", ["34"]),
        ("30 µs<!-- figure: ~speed.fk -->", ["30"]),
        ("30 ns<!-- figure: speed.fk*1000 -->", ["34400"]),
        ("1 x, 20.5 / 10 mm <!-- figure: error.axes[0:2] -->", ["20.6", "10"]),
        ("| 1 | 12.0 | 3 <!-- figure: error.axes[2] speed.fk --> |", ["11.5", "34"]),
        ("below 1e-10 <!-- figure: <share -->", ["1e-10"]),
        ("below 1e-11 <!-- figure: <share -->", ["1e-10"]),
        ("under 34 µs <!-- figure: <speed.fk -->", ["35"]),
        ("just 2e-11 <!-- figure: share -->", ["1e-10"]),
        ("just 2.0e-11 <!-- figure: share -->", ["9.9e-11"]),
        ("some 12 000 <!-- figure: speed.fk*1000 -->", ["34 400"]),
    ],
)
def test_a_number_is_corrected_to_the_digits_that_it_shows(text, shown):
    citations, faults = figures.read_page(text, "page", FIGURES)
    assert faults == []
    assert [citation.expected for citation in citations] == shown
    again, _ = figures.read_page(figures.corrected(text, citations), "page", FIGURES)
    assert [citation.shown for citation in again] == shown


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("3 <!-- figure: speed.ik -->", "page:1: results.json has no figure 'speed.ik'"),
        ("\n3 <!-- figure: error.axes -->", "page:2: 3 values for 1 numbers before them"),
        ("3 <!-- figure: error.axes[3] -->", "fewer values than 'error.axes[3]' wants"),
        ("3 <!-- source: tests/test_figures.py::test_x -->", "no test 'tests/test_figures.py"),
    ],
)
def test_a_comment_that_leads_nowhere_is_a_fault(text, fault):
    _, faults = figures.read_page(text, "page", FIGURES)
    assert len(faults) == 1
    assert fault in faults[0]


def test_a_section_is_written_with_its_figures(tmp_path, monkeypatch):
    catalogue = '["swing"]\nsection = "sway"\nprotocol = "A push."\ncolumn = "error [mm]"\n'
    (tmp_path / "figures.toml").write_text(catalogue + 'rows = { ours = "a | 1", other = "b" }\n')
    monkeypatch.setattr(figures, "CATALOGUE", tmp_path / "figures.toml")
    monkeypatch.setattr(figures, "VALUES", tmp_path / "results.json")
    for module in (figures, results):
        monkeypatch.setattr(module, "RESULTS", tmp_path / "RESULTS.md")
    body = results.table(["robot", "seed", "error [mm]"], [["a", "0", "2"], ["a", "1", "3.50"]])
    results.write_section("sway", "Sway", "python -m sway", body)
    section = json.loads((tmp_path / "results.json").read_text())["sway"]
    assert section["command"] == "python -m sway"
    assert section["figures"] == {"swing.ours": {"value": 3.5, "unit": "mm", "protocol": "A push."}}
    assert figures.refresh_values() == [
        "swing.other: section 'sway' has 0 cells in row 'b', column 'error [mm]'"
    ]
