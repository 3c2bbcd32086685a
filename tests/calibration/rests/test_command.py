from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

import carosac_toolkit as ct
from carosac_toolkit.cli.main import main
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.pictures.saving import PICTURE_FORMATS
from carosac_toolkit.recordings.encoders import calibrated
from carosac_toolkit.recordings.files import save_recording
from tests.calibration.rests.scenes import scene


@pytest.fixture(scope="module")
def drawn():
    return scene(5, ct.load_robot("scampi"), swivel=False)


@pytest.fixture
def rests(drawn, tmp_path):
    save_recording(drawn.recording, tmp_path / "rests.csv")
    return str(tmp_path / "rests.csv")


def test_a_recording_without_poses_gives_zeros_report_and_numbers(drawn, rests, tmp_path, capsys):
    output, folder, numbers = tmp_path / "new.yaml", tmp_path / "report", tmp_path / "out.json"
    words = ["--output", str(output), "--report", str(folder), "--json", str(numbers)]
    assert main(["calibrate", "lengths", rests, *words]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "27 rests, no poses; robot scampi" in said
    assert "at the first rest the platform is at" in said
    assert "tension_scale[front_left]" in said
    assert "exit points are held" in said
    data = json.loads(numbers.read_text())
    assert len(data["positions_m"]) == data["rests"] == 27
    assert data["useless"] is False and data["warnings"] == []
    assert np.linalg.norm(np.array(data["positions_m"][0]) - drawn.position[0]) < 0.03
    page = (folder / "report.html").read_text()
    assert "Errors of other sensors" in page and "Poses of rest" in page
    pictures = {f"{name}.{kind}" for name in ("poses", "residuals") for kind in PICTURE_FORMATS}
    assert {p.name for p in folder.glob("[!.]*")} == {"report.html", *pictures}
    robot = ct.load_robot(str(output))
    assert robot.calibrated == tuple(f"length_offset[{c}]" for c in robot.cable_names)
    assert robot.calibration_covariance is not None
    material = calibrated(drawn.recording, robot)  # and the zeros lead to the pose of rest
    rest = statics.forward_kinematics(robot, material.unstrained_length[5:6])
    assert np.linalg.norm(rest.position[0] - drawn.position[0]) < 0.03


def test_options_of_poses_are_refused_without_them_and_the_other_way_round(rests, capsys):
    assert main(["calibrate", "lengths", rests, "--exit-prior", "0.1"]) == 2
    assert "--exit-prior: got 0.1; allowed: not with a recording without poses" in (
        capsys.readouterr().err
    )
    assert main(["calibrate", "lengths", "synthetic", "--swivel-noise", "0.01"]) == 2
    assert "--swivel-noise: got 0.01; allowed: only with swivel angles" in (capsys.readouterr().err)
    assert main(["calibrate", "lengths", rests, "--tension-noise", "0"]) == 2
    assert "--tension-noise: got 0.0; allowed: --tension-noise > 0" in capsys.readouterr().err


def test_lengths_alone_are_refused(drawn, tmp_path, capsys):
    alone = replace(drawn.recording, tension=None, attitude=None)
    save_recording(alone, tmp_path / "alone.csv")
    assert main(["calibrate", "lengths", str(tmp_path / "alone.csv")]) == 2
    assert "leave the first pose unknown by more than the frame is wide" in capsys.readouterr().err


def test_a_useless_robot_is_not_written(drawn, tmp_path, capsys):
    tension = drawn.recording.tension
    swapped = replace(tension, value=tension.value[:, [1, 0, 2, 3]])
    save_recording(replace(drawn.recording, tension=swapped), tmp_path / "swapped.csv")
    output = tmp_path / "new.yaml"
    assert main(["calibrate", "lengths", str(tmp_path / "swapped.csv"), "--output", str(output)])
    said = capsys.readouterr()
    assert not output.exists()
    assert "would be of no use" in said.out or "cannot rest" in said.err
