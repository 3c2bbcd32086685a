"""`carosac distill`, as a user runs it."""

from __future__ import annotations

import json

import pytest

from carosac_toolkit.cli.main import main
from carosac_toolkit.robot.file import robot_text

pytest.importorskip("torch")


@pytest.fixture(scope="module")
def robot_file(tmp_path_factory):
    """A robot whose paths are short."""
    text = robot_text("carosac")
    box = "workspace: {center: [0.4, -1.8, 3.0], size: [4, 4, 4]}"
    assert box in text
    path = tmp_path_factory.mktemp("robot") / "small.yaml"
    path.write_text(text.replace(box, "workspace: {center: [0.4, -1.8, 2.2], size: [1, 1, 1]}"))
    return path


def test_a_training_leaves_a_network_that_compare_takes(robot_file, tmp_path, capsys):
    words = ["distill", "--robot", str(robot_file), "--drives", "1", "--updates", "50",
             "--workers", "1", "--output", str(tmp_path / "out")]  # fmt: skip
    assert main([*words, "--json", str(tmp_path / "first.json")]) in (0, 1)  # hardly trained
    data = json.loads((tmp_path / "first.json").read_text())
    assert [row["drives"] for row in data["rounds"]] == [1, 2, 3, 4]
    assert "off, held out [N]" in capsys.readouterr().out
    (tmp_path / "out" / ".carosac-results").unlink()  # as if it had been killed
    assert main(words) in (0, 1)  # all is there already
    status = main([
        "compare", "--robot", str(robot_file), "--controllers", "approximate_mpc",
        "--estimators", "dynamic_estimator", "--trajectories", "fast_move", "--seeds", "1",
        "--workers", "0", "--set", f"controller.approximate_mpc.policy={data['network']}",
        "--output", str(tmp_path / "study"),
    ])  # fmt: skip
    assert status in (0, 1)  # it has hardly learned anything
    assert "approximate_mpc" in capsys.readouterr().out
    assert main([*words, "--seed", "3"]) == 2
    assert "with another training" in capsys.readouterr().err


def test_wrong_options_are_refused(robot_file, tmp_path, capsys):
    assert main(["distill", "--robot", str(robot_file), "--drives", "0"]) == 2
    assert "--drives" in capsys.readouterr().err
    assert main(["distill", "--robot", "cogiro", "--output", str(tmp_path / "eight")]) == 2
    assert "3 to 5" in capsys.readouterr().err
    assert not (tmp_path / "eight").exists()


def test_a_network_of_the_family_is_trained_for_any_robot_of_it(tmp_path, capsys):
    words = ["distill", "--family", "--drives", "1", "--updates", "20", "--workers", "1"]
    out = ["--output", str(tmp_path / "out")]
    assert main([*words, *out, "--json", str(tmp_path / "family.json")]) in (0, 1)
    data = json.loads((tmp_path / "family.json").read_text())
    assert data["robot"] == "suspended-4"
    assert [row["robots"] for row in data["rounds"]] == [1, 2, 3, 4]
    assert "over the weight per cable" in " ".join(capsys.readouterr().out.split())
    assert main([*words, "scampi"]) == 2
    assert "none with --family" in capsys.readouterr().err
    assert main([*words, "--tension-share", "0.5"]) == 2
    assert "--tension-share: got 0.5; allowed: none with --family" in capsys.readouterr().err
