"""Links of pages and notebooks lead somewhere; the start page leads to every group of pages."""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "docs"))
import links  # noqa: E402

DOCS = ROOT / "docs"
START = (DOCS / "index.md").read_text(encoding="utf-8")
TASK_ROW = re.compile(r"^\| (?!I want to|---)(.+?) \| (.+?) \|$", re.MULTILINE)


@pytest.mark.parametrize("page", links.pages(), ids=lambda page: str(page.relative_to(ROOT)))
def test_links_inside_the_project_lead_somewhere(page):
    assert links.broken(page) == []


def test_links_are_looked_for_in_readme_pages_and_notebooks():
    found = {str(page.relative_to(ROOT)) for page in links.pages()}
    assert {"README.md", "CONTRIBUTING.md", "docs/index.md", "docs/api/index.md"} <= found
    assert {f"docs/notebooks/{name}.ipynb" for name in ("calibrate", "my-robot", "sway")} <= found


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("[a](gone.md)", "gone.md: no such file"),
        ("![a](gone.png)", "gone.png: no such file"),
        ("[a](other.md#gone)", "other.md#gone: no such heading"),
        ("# Here\n\n[a](#there)", "#there: no such heading"),
        ('<img src="gone.webp" width="3">', "gone.webp: no such file"),
        ("| a |\n|---|\n| [b](gone.md) |", "gone.md: no such file"),
    ],
)
def test_a_broken_link_is_noticed(tmp_path, text, fault):
    (tmp_path / "other.md").write_text("# Other\n")
    page = tmp_path / "page.md"
    page.write_text(text)
    assert links.broken(page) == [fault]


@pytest.mark.parametrize(
    "text",
    [
        "[a](other.md#two-words-and-code)",
        "[a](other.md#again-1)",
        "# Here\n\n[a](#here)",
        "`[a](gone.md)`",
        "```\n[a](gone.md)\n```",
        "[a](https://example.org/gone#x)",
        "<mailto:someone@example.org>",
        "[a][b]\n\n[b]: other.md",
    ],
)
def test_a_link_that_leads_somewhere_is_no_fault(tmp_path, text):
    headings = "# Two words, and `code`\n\n## Again\n\n## Again\n"
    (tmp_path / "other.md").write_text(headings)
    page = tmp_path / "page.md"
    page.write_text(text)
    assert links.broken(page) == []


@pytest.mark.parametrize("page", sorted(DOCS.glob("*.md")), ids=lambda page: page.stem)
def test_no_comment_at_the_start_of_a_line_hides_links(page):
    assert links.hidden(page) == []


def test_a_link_behind_a_comment_at_the_start_of_a_line_is_noticed(tmp_path):
    page = tmp_path / "page.md"
    page.write_text(
        "Takes 3 ms\n<!-- figure: x --> for [a](page.md).\nIt takes 3<!-- y --> [b](c)."
    )
    assert links.hidden(page) == ["[a](page.md): follows HTML at the start of its line"]


def test_a_broken_link_of_a_notebook_is_noticed(tmp_path):
    cells = [
        {"cell_type": "markdown", "source": ["# Text\n", "[a](gone.md)"]},
        {"cell_type": "code", "source": ["a = '[b](nowhere.md)'"]},
    ]
    page = tmp_path / "page.ipynb"
    page.write_text(json.dumps({"cells": cells}))
    assert links.broken(page) == ["gone.md: no such file"]


def site_of(folder, start, words):
    """Write a site of two pages and its search index."""
    (folder / "index.html").write_text(start)
    (folder / "page.html").write_text('<h1 id="title">Page</h1><a name="old"></a>')
    names = sorted(set(links.SEARCHED.values()))
    stems = {"page": 0} | {word: names.index(page) for word, page in words.items()}
    index = {"docnames": names, "terms": stems, "titleterms": {}}
    (folder / "searchindex.js").write_text(f"Search.setIndex({json.dumps(index)})")


@pytest.mark.parametrize(
    ("start", "faults"),
    [
        ('<a href="page.html#title"><a href="page.html#old"><a href="https://x.org">', []),
        ('<a href="gone.html">', ["index.html: gone.html: no such file"]),
        ('<img src="gone.png">', ["index.html: gone.png: no such file"]),
        ('<a href="page.html#gone">', ["index.html: page.html#gone: no such anchor"]),
    ],
)
def test_a_broken_link_of_the_site_is_noticed(tmp_path, start, faults):
    site_of(tmp_path, start, {})
    assert links.broken_in_site(tmp_path) == faults


def test_a_search_that_finds_nothing_is_noticed(tmp_path, monkeypatch):
    monkeypatch.setattr(links, "SEARCHED", {"winch": "plc", "sway": "mpc"})
    site_of(tmp_path, "", {"winch": "plc", "sway": "plc"})
    assert links.not_found(tmp_path) == ["search: 'sway' does not find the page mpc"]


def test_the_site_check_ends_with_status_1_for_a_fault(tmp_path, monkeypatch, capsys):
    site_of(tmp_path, '<a href="gone.html">', {})
    monkeypatch.setattr(links, "SEARCHED", {})
    monkeypatch.setattr(sys, "argv", ["links.py", str(tmp_path)])
    assert links.main() == 1
    assert capsys.readouterr().out == "index.html: gone.html: no such file\n"
    monkeypatch.setattr(sys, "argv", ["links.py", str(tmp_path / "nothing")])
    assert links.main() == 2
    assert "usage: python docs/links.py FOLDER" in capsys.readouterr().err


def test_the_start_page_is_a_table_of_tasks_that_lead_to_pages():
    assert "| I want to | Read |" in START
    rows = TASK_ROW.findall(START)
    assert len(rows) >= 12
    assert [task for task, targets in rows if "](" not in targets] == []
    linked = set(re.findall(r"\]\(([^)#]+)", "".join(targets for _, targets in rows)))
    must = {path.name for path in DOCS.glob("tutorial-*.md")}
    must |= {f"notebooks/{path.name}" for path in (DOCS / "notebooks").glob("*.ipynb")}
    assert must - linked == set()


def test_every_page_is_in_the_navigation():
    listed = set()
    for block in re.findall(r"```\{toctree\}\n(.*?)```", START, re.DOTALL):
        assert re.search(r"^:caption: \S", block, re.MULTILINE)
        listed |= {line for line in block.splitlines() if line and not line.startswith(":")}
    own = [p for p in links.pages() if DOCS in p.parents and p.parent.name != "api"]
    names = {str(page.relative_to(DOCS).with_suffix("")) for page in own}
    assert names - {"index"} | {"gallery", "api/index"} == listed
