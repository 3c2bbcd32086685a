"""Every example, and the program in the README, runs; as a reader would run it, or in here."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.programs import run_here

ROOT = Path(__file__).resolve().parents[1]
EXAMPLES = sorted((ROOT / "examples").glob("[!_]*.py"))
LINES = 100
ARTIFACTS = os.environ.get("CAROSAC_ARTIFACTS")  # folder, or None


# Run as a reader would run it and in this process, with one result. The others run in this process
# alone; of what they do, tests of calibration, simulator and studies say that it repeats.
TWICE = ("01_hang",)


def run(program: Path, folder: Path) -> str:
    done = subprocess.run(
        [sys.executable, str(program)], capture_output=True, text=True, cwd=folder, timeout=300
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_there_are_examples():
    assert EXAMPLES


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_example_is_short_draws_one_picture_and_prints_one_number(example, tmp_path, capsys):
    assert len(example.read_text(encoding="utf-8").splitlines()) < LINES
    run_here(example, tmp_path)
    printed = capsys.readouterr().out
    pictures = list(tmp_path.iterdir())
    assert [picture.name for picture in pictures] == [f"{example.stem}.png"]
    assert pictures[0].read_bytes().startswith(b"\x89PNG") and pictures[0].stat().st_size > 10_000
    assert len(printed.splitlines()) == 1 and re.search(r"\d", printed)
    if ARTIFACTS:  # the gallery of the documentation shows it
        Path(ARTIFACTS).mkdir(parents=True, exist_ok=True)
        shutil.copy(pictures[0], ARTIFACTS)
    if example.stem in TWICE:
        assert run(example, tmp_path) == printed


def test_program_in_the_readme_prints_what_the_readme_says(tmp_path):
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    found = re.search(r"```python\n(.*?)```.*?```text\n(.*?)```", text, re.DOTALL)
    assert found is not None
    program = tmp_path / "readme.py"
    program.write_text(found[1], encoding="utf-8")
    assert run(program, tmp_path) == found[2]
