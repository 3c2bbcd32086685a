"""The files around the code agree with each other."""

from __future__ import annotations

import re
import tomllib
from importlib.metadata import requires
from pathlib import Path

import pytest
from PIL import Image

import carosac_toolkit
from carosac_toolkit.base.yaml import load_yaml
from carosac_toolkit.physics.kernel_modules import kernel_modules
from carosac_toolkit.robot.file import parse_robot
from tests.programs import run_here

ROOT = Path(__file__).resolve().parents[1]
README_WORDS_MAX = 700
README_ANIMATION_BYTES_MAX = 3_000_000
PAGES = (
    "calibration", "calibration-identify", "calibration-lengths", "calibration-tachymeter",
    "calibration-without-poses", "commissioning", "drivers", "dynamic-estimator",
    "learned-control", "recordings", "robot-yaml", "statics", "trajectories",
    "workspace",
)  # fmt: skip
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))


def test_one_version_everywhere():
    citation = load_yaml((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    versions = {PROJECT["project"]["version"], carosac_toolkit.__version__, citation["version"]}
    assert len(versions) == 1


def test_changelog_has_unreleased_on_top_and_then_this_version_with_entries():
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    unreleased, release, *_ = re.split(r"^## ", text, flags=re.MULTILINE)[1:]
    assert unreleased.startswith("[Unreleased]")
    citation = load_yaml((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert release.startswith(f"[{citation['version']}] - {citation['date-released']}\n")
    assert re.search(r"^- \S", release, re.MULTILINE)
    kinds = re.findall(r"^### (.*)", text, re.MULTILINE)
    assert set(kinds) <= {"Added", "Changed", "Deprecated", "Removed", "Fixed", "Security"}


def test_mypy_leaves_out_exactly_the_kernels():
    overrides = PROJECT["tool"]["mypy"]["overrides"]
    skipped = {name for entry in overrides if "follow_imports" in entry for name in entry["module"]}
    packages = (ROOT / name for name in ("carosac_toolkit", "learned", "sim_warp"))
    files = [path for package in packages for path in package.rglob("*_kernels.py")]
    kernels = {".".join(path.relative_to(ROOT).with_suffix("").parts) for path in files}
    assert skipped - {"warp.*"} == kernels
    assert set(kernel_modules(("learned", "sim_warp"))) <= kernels


def test_every_dependency_is_pinned_and_explained():
    pins = (ROOT / "constraints.txt").read_text(encoding="utf-8")
    pinned = {plain(line.partition("==")[0]) for line in pins.splitlines() if "==" in line}
    explained = plain((ROOT / "docs" / "dependencies.md").read_text(encoding="utf-8"))
    needed = {re.split(r"[^\w.-]", line)[0] for line in requires("carosac-toolkit") or []}
    assert {name for name in needed if plain(name) not in pinned} == set()
    assert {name for name in needed if plain(name) not in explained} == set()


def plain(name: str) -> str:
    """A distribution's name as indexes compare it."""
    return re.sub(r"[-_.]+", "-", name).lower()


def test_readme_takes_a_minute_and_begins_with_an_animation():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert len(text.split()) <= README_WORDS_MAX
    (image,) = re.findall(r"!\[[^\]]*\]\(([^)]*)\)", text)
    path = ROOT / image
    assert path.stat().st_size < README_ANIMATION_BYTES_MAX
    with Image.open(path) as picture:
        assert picture.n_frames > 50 and picture.info["loop"] == 0  # it repeats
        assert picture.width >= 800
    for words in ("It is for you if", "It is not for you if", "never driven a real robot"):
        assert words in text
        assert text.index(words) < text.index("## ")  # on the first screen


def test_the_demo_is_the_default_study_with_the_animation_of_the_readme():
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    (words,) = re.findall(r"^demo: .*\n\t@\$\(BIN\)/carosac (.*)$", makefile, re.MULTILINE)
    assert words.split()[:-1] == (
        "compare --seeds 6 --animation kinematic_solver mpc td3 --output".split()
    )


def test_robot_file_in_the_docs_is_right():
    text = (ROOT / "docs" / "robot-yaml.md").read_text(encoding="utf-8")
    example = re.search(r"```yaml\n(.*?)```", text, re.DOTALL)
    assert example is not None
    assert parse_robot(example[1]).n == 4


@pytest.mark.parametrize("page", PAGES)
def test_programs_in_the_docs_run(page, tmp_path):
    text = (ROOT / "docs" / f"{page}.md").read_text(encoding="utf-8")
    programs = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    assert programs
    (tmp_path / "here").mkdir()
    for number, program in enumerate(programs):
        file = tmp_path / f"program_{number}.py"
        file.write_text(program, encoding="utf-8")
        run_here(file, tmp_path / "here")
