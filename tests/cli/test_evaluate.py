"""`carosac evaluate` says what a policy does, beside inverse kinematics on the same paths."""

from __future__ import annotations

import json
from dataclasses import asdict, replace

import numpy as np
import pytest

import carosac_toolkit as ct
from carosac_toolkit.cli.main import main
from learned.environment import EnvironmentSettings
from learned.policy_file import PolicyDescription, write_policy
from learned.rewards import RewardSettings
from learned.target_paths import PathSettings

pytest.importorskip("onnx")

PUSH = EnvironmentSettings(
    world="realtime", observation=("error",), action="push",
    reward=RewardSettings(terms=("tracking",)),
    path=PathSettings(kind="minimum_snap", period=0.05, steps=10),
)  # fmt: skip


def evaluated(folder, capsys, *words):
    """Exit status, JSON and what was printed."""
    out = ["--output", str(folder / "pictures"), "--json", str(folder / "e.json")]
    status = main(["evaluate", *words, *out])
    data = json.loads((folder / "e.json").read_text())
    ends = (".png", ".svg", ".pdf")
    files = sorted(x.name for x in (folder / "pictures").iterdir() if x.suffix in ends)
    assert {"scores.npz", "robot.npz"} <= {x.name for x in (folder / "pictures").iterdir()}
    assert sorted(path.rpartition("/")[2] for path in data["pictures"]) == files
    return status, data, capsys.readouterr().out


def test_a_bundled_policy_of_set_points_stands_beside_inverse_kinematics(tmp_path, capsys):
    status, data, printed = evaluated(tmp_path, capsys, "carosac-settle", "--trajectories", "2")
    assert status == 0
    exact = data["inverse_kinematics"]
    assert exact["rmse_m"] < 1e-5 < data["rmse_m"] < 0.03
    assert exact["slack_share"] == exact["failures"] == 0
    assert not {"inconsistency_m", "median_tilt_rad", "length_error_m"} & set(exact)
    assert "rmse_ratio" not in data and "rmse.png" not in printed
    (inconsistency,) = (row for row in printed.splitlines() if "median inconsistency" in row)
    assert inconsistency.rstrip().endswith("-")  # none, by definition
    for name in ("what", "RMSE of the distance", "points with a slack cable"):
        (row,) = (row for row in printed.splitlines() if row.startswith(name))
        assert len(row[len(name) :].split("  ")) > 2, row


@pytest.mark.parametrize("feedforward", [False, True])
def test_a_policy_that_never_pushes_adds_nothing(feedforward, tmp_path, capsys):
    settings = replace(PUSH, feedforward=feedforward)
    description = PolicyDescription(
        preset="none", robot=ct.load_robot("carosac"), observation=PUSH.observation,
        action="push", period=0.05, settings={"environment": asdict(settings)}, seed=0, steps=0,
        commit="", scores={},
    )  # fmt: skip
    layers = [(np.zeros((3, 3), dtype=np.float32), np.zeros(3, dtype=np.float32))]
    write_policy(tmp_path / "still.onnx", layers, "relu", description)
    path = str(tmp_path / "still.onnx")
    status, data, printed = evaluated(tmp_path, capsys, path, "--trajectories", "2")
    assert (status, data["protocol"]) == (0, "realtime")
    other = data["feedforward" if feedforward else "inverse_kinematics"]
    assert {name: data[name] for name in other} == other
    assert ("feedforward" in data) == ("with feedforward" in printed) == feedforward
    assert (data["rmse_ratio"] == 1.0) != feedforward
    (ratio,) = (row for row in printed.splitlines() if row.startswith("RMSE over"))
    assert ratio.count(f"{data['rmse_ratio']:.2f}") == 1 + feedforward
    assert (tmp_path / "pictures" / "rmse.png").exists()
    assert data["slack_share_at_rest"] <= 1.0 and "slack at rest, on IK's lengths" in printed
    assert "at rest: plants that hang still" in printed and "slack: below the least" in printed
    assert ("with feedforward: catenary IK that also" in printed) == feedforward
    assert "has not learned yet" not in printed


def test_other_paths_go_to_another_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for words in ((), ("--seed", "3")):
        main(["evaluate", "carosac-no-sag", "--trajectories", "2", *words])
    first, second = sorted((tmp_path / "carosac-results" / "evaluate").iterdir())
    assert first.name.endswith("no-sag-2paths")
    assert second.name == f"{first.name}-of-seed3"
