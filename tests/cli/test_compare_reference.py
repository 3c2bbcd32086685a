"""``carosac compare --suite``, on a small suite that runs in seconds."""

import csv
import json
from dataclasses import replace
from pathlib import Path

import pytest

from carosac_toolkit.cli.compare import Options
from carosac_toolkit.cli.compare_reference import _folder
from carosac_toolkit.cli.main import main
from carosac_toolkit.studies.reference.cases import ReferenceSuite

pytestmark = pytest.mark.usefixtures("quick_pictures")

SMALL = {
    "robots": ["carosac"], "trajectories": ["line"], "speed_max": 2.5, "acceleration_max": 2.5,
    "seeds": [0], "driver": "quasi_static", "driver_settings": {}, "suite": "lengths",
    "perturbation": "nominal-1", "only": {"td3": ["carosac"]},
    "parts": {
        "tracking": {
            "controllers": ["kinematic_solver", "straight_line"],
            "estimators": ["kinematic_solver"],
        },
    },
}  # fmt: skip
NAMES = ("results.csv", "reference.json", "tables.md")


@pytest.fixture(autouse=True)
def small_suite(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    real = ReferenceSuite.load("reference")
    small = replace(real, name="small-1", definition={"name": "small-1", **SMALL})
    monkeypatch.setattr(ReferenceSuite, "load", classmethod(lambda cls, name: small))
    return small


def test_the_whole_suite_then_an_entry_beside_what_was_published(small_suite, capsys):
    words = ["compare", "--suite", "reference", "--workers", "0"]
    assert main([*words, "--output", "all", "--json", "x.json"]) == 0
    data = json.loads(Path("x.json").read_text())
    assert (data["suite"], data["digest"]) == ("small-1", small_suite.digest)
    assert [part["part"] for part in data["parts"]] == ["tracking"]
    assert all(Path("all", name).is_file() for name in NAMES)
    assert Path("all/tracking/carosac/report.html").is_file()
    rows = list(csv.DictReader(Path("all/results.csv").open()))
    assert [row["controller"] for row in rows if row["part"] == "tracking"] == [
        "kinematic_solver", "straight_line"
    ]  # fmt: skip
    assert small_suite.digest in Path("all/tables.md").read_text()
    out = capsys.readouterr().out
    assert max(map(len, out.splitlines())) <= 80

    mine = "baselines.straight_line_controller:StraightLineController"
    entry = ["--controllers", mine, "--against", "all", "--output", "mine"]
    assert main([*words, *entry, "--json", "y.json"]) == 0
    out = " ".join(capsys.readouterr().out.split())
    assert "The cases that ran here agree with the published ones within 0.00 %" in out
    parts = json.loads(Path("y.json").read_text())["parts"]
    assert [part["part"] for part in parts] == ["tracking"]
    labels = [one["label"] for one in parts[0]["blocks"][0]["compared"]]
    assert labels == ["kinematic_solver", mine, "straight_line (published)"]
    both = parts[0]["blocks"][0]["compared"][1:]
    ratios = [one["against_baseline"]["tracking"]["ratio"]["value"] for one in both]
    assert ratios[0] == pytest.approx(ratios[1], rel=1e-4)  # one controller under two names
    assert f"--controllers {mine}" in Path("mine/tables.md").read_text()


def test_published_results_of_another_definition_are_refused_before_anything_runs(capsys):
    Path("other").mkdir()
    Path("other/reference.json").write_text(
        json.dumps({"schema": "carosac-reference/1", "suite": "small-2", "digest": "f" * 16})
    )
    words = ["compare", "--suite", "reference", "--against", "other", "--output", "o"]
    assert main(words) == 2
    assert "cannot be compared" in capsys.readouterr().err and not Path("o").exists()
    assert main([*words[:3], "--against", "nowhere", "--output", "o"]) == 2
    assert "nowhere/reference.json: no such file" in capsys.readouterr().err


def test_published_rows_are_read_before_anything_runs(small_suite, capsys):
    Path("other").mkdir()
    same = {"schema": "carosac-reference/1", "suite": "small-1", "digest": small_suite.digest}
    Path("other/reference.json").write_text(json.dumps(same))
    assert main(["compare", "--suite", "reference", "--against", "other", "--output", "o"]) == 2
    assert "other/results.csv: no such file" in capsys.readouterr().err and not Path("o").exists()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--speed", "1.5"], "--speed: got 1.5; allowed: nothing with --suite"),
        (["--seeds", "3"], "--seeds: got 3"),
        (["--trajectories", "line"], "--trajectories: got ('line',)"),
        (["--set", "driver.cables=straight"], "none with --suite, which fixes it"),
        (["--controllers", "nobody"], "--controllers: got 'nobody'"),
    ],
)
def test_what_the_suite_fixes_cannot_be_changed(words, message, capsys):
    assert main(["compare", "--suite", "reference", *words, "--output", "o"]) == 2
    assert message in capsys.readouterr().err and not Path("o").exists()


def test_entries_go_to_folders_of_their_own(small_suite):
    entered = Options(suite="reference", controllers=("my.module:C",), settings=("a.b=1",))
    folder = _folder(entered, small_suite)
    assert folder == Path("carosac-results/small-1-my.module_C-a.b=1")
    assert _folder(Options(suite="reference"), small_suite) == Path("carosac-results/small-1")
