"""The page that tells users how to add a controller, done word by word in a temporary folder."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

PAGE = Path(__file__).resolve().parents[1] / "docs" / "your-controller.md"


def execute(site: Path, folder: Path, *words: str) -> str:
    """Run Python in a folder, with the installed package but nothing else of ours on the path."""
    done = subprocess.run(
        [sys.executable, *words],
        capture_output=True, text=True, cwd=folder, env=os.environ | {"PYTHONPATH": str(site)},
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def package(tmp_path_factory):
    """The package of the page, installed by pip outside this project; no network is used."""
    source, site = (tmp_path_factory.mktemp(name) for name in ("source", "site"))
    blocks = re.findall(r"```(python|toml)\n(.*?)```", PAGE.read_text("utf-8"), re.DOTALL)
    assert [kind for kind, _ in blocks] == ["python", "toml", "python", "python"]
    names = ("tilted.py", "pyproject.toml", "study.py", "test_tilted.py")
    for name, (_, text) in zip(names, blocks, strict=True):
        (source / name).write_text(text, encoding="utf-8")
    options = "--quiet --no-deps --no-build-isolation --no-index --target".split()
    execute(site, source, "-m", "pip", "install", *options, str(site), ".")
    assert not (site / "study.py").exists()
    (source / "tilted.py").unlink()  # from here on it is the installed one
    return source, site


def test_it_is_found_by_its_name(package):
    source, site = package
    program = "from carosac_toolkit.loop import plugins as r; print(r.names('controllers'), "
    printed = execute(site, source, "-c", program + "r.load('controllers', 'tilted').__module__)")
    assert "'straight_line', 'td3', 'tilted'] tilted" in printed


def test_its_study_runs_and_it_halves_the_error_of_the_straight_line(package):
    source, site = package
    lines = execute(site, source, "study.py").splitlines()
    rows = {name: (status, float(error)) for name, status, error in map(str.split, lines)}
    assert {name: status for name, (status, _) in rows.items()} == {
        "straight_line": "ok",
        "tilted:Tilted": "ok",
    }
    assert rows["tilted:Tilted"][1] < 0.5 * rows["straight_line"][1]


def test_it_keeps_the_contract(package):
    source, site = package
    printed = execute(site, source, "-m", "pytest", "-q", "-p", "no:cacheprovider")
    assert re.search(r"\d+ passed", printed) and "failed" not in printed
