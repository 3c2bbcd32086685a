"""Every notebook runs from top to bottom, and is committed without outputs."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import nbformat
import pytest

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "docs"))
import notebooks  # noqa: E402

CELLS_MAX = 25
LONGEST = "calibrate"
ARTIFACTS = os.environ.get("CAROSAC_ARTIFACTS")  # folder, or None


def notebook_of(folder, *codes):
    """Write a notebook with the given code cells."""
    cells = [nbformat.v4.new_code_cell(code) for code in codes]
    path = folder / "small.ipynb"
    nbformat.write(nbformat.v4.new_notebook(cells=cells), path)
    return path


def outputs_of(notebook, kind):
    """Outputs of a kind, such as ``stream`` or ``image/png``."""
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    return [o for o in outputs if o.output_type == kind or kind in o.get("data", {})]


def test_there_are_three_notebooks():
    assert {path.stem for path in notebooks.NOTEBOOKS} == {"calibrate", "my-robot", "sway"}


@pytest.mark.parametrize("path", notebooks.NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_is_short_and_has_no_outputs(path):
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    assert len(notebook.cells) < CELLS_MAX
    assert notebook.cells[0].source.startswith("# ")
    assert set(notebook.metadata) <= {"kernelspec", "language_info"}
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert [c.execution_count for c in code if c.outputs or c.execution_count is not None] == []


@pytest.mark.parametrize(
    "path",
    [
        pytest.param(path, marks=pytest.mark.slow) if path.stem == LONGEST else path
        for path in notebooks.NOTEBOOKS
    ],
    ids=lambda path: path.stem,
)
def test_notebook_runs_without_the_command_on_the_path(path, monkeypatch):
    monkeypatch.setenv("PATH", "/usr/bin:/bin")
    executed = notebooks.execute(path)
    pictures = outputs_of(executed, "image/png")
    assert len(pictures) >= 2
    figures = [o for o in outputs_of(executed, "text/plain") if "<Figure" in o.data["text/plain"]]
    assert [figure for figure in figures if figure not in pictures] == []  # all are shown
    if ARTIFACTS:  # the documentation shows it
        Path(ARTIFACTS).mkdir(parents=True, exist_ok=True)
        nbformat.write(executed, Path(ARTIFACTS) / path.name)


def test_a_cell_that_raises_is_a_failure_that_names_it(tmp_path):
    path = notebook_of(tmp_path, "x = 3", "y = x / 0")
    with pytest.raises(notebooks.NotebookFailed, match=r"small\.ipynb: (?s:.*)y = x / 0") as error:
        notebooks.execute(path)
    assert "ZeroDivisionError" in str(error.value)
    assert "\x1b" not in str(error.value)


def test_a_command_that_fails_is_a_failure(tmp_path):
    words = '[sys.executable, "-m", "carosac_toolkit.cli.main", "check", "no-such-robot.yaml"]'
    path = notebook_of(tmp_path, f"import subprocess, sys\nsubprocess.run({words}, check=True)")
    with pytest.raises(notebooks.NotebookFailed, match="CalledProcessError"):
        notebooks.execute(path)


def test_a_cell_that_takes_too_long_is_a_failure(tmp_path, monkeypatch):
    monkeypatch.setattr(notebooks, "CELL_TIME_MAX_S", 1)
    path = notebook_of(tmp_path, "import time\ntime.sleep(60)")
    with pytest.raises(notebooks.NotebookFailed, match=r"timed out(?s:.*)time\.sleep\(60\)"):
        notebooks.execute(path)


def test_a_figure_is_shown_also_where_the_tests_draw_without_a_window(tmp_path, monkeypatch):
    monkeypatch.setenv("MPLBACKEND", "Agg")
    code = "import matplotlib.pyplot as plt\nplt.plot([1, 2]);"
    assert len(outputs_of(notebooks.execute(notebook_of(tmp_path, code)), "image/png")) == 1


def test_a_notebook_sees_its_own_interpreter_and_an_empty_folder(tmp_path):
    code = "import os, sys\nprint(sys.executable, os.listdir())"
    (stream,) = outputs_of(notebooks.execute(notebook_of(tmp_path, code)), "stream")
    assert stream.text == f"{sys.executable} []\n"


def test_pages_show_what_the_tests_executed_and_run_only_what_changed(tmp_path, monkeypatch):
    ran = []

    def execute(path):
        ran.append(path)
        return nbformat.read(path, as_version=4)

    source = notebook_of(tmp_path, "print(1)")
    artifacts = tmp_path / "artifacts"
    artifacts.mkdir()
    monkeypatch.setattr(notebooks, "NOTEBOOKS", [source])
    monkeypatch.setattr(notebooks, "CACHE", tmp_path / "build" / "cache")
    monkeypatch.setattr(notebooks, "execute", execute)
    monkeypatch.setenv("CAROSAC_ARTIFACTS", str(artifacts))
    notebooks.make()
    notebooks.make()
    assert len(ran) == 1
    notebook_of(tmp_path, "print(2)")
    notebook_of(artifacts, "print(2)")
    notebooks.make()
    assert len(ran) == 1
    notebook_of(tmp_path, "print(3)")
    notebooks.make()
    assert len(ran) == 2
