import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

import carosac_toolkit as ct
from calibration.self_calibration.command import run_motor_angles
from carosac_toolkit.base.errors import CarosacError, InvalidField
from carosac_toolkit.base.files import write_json
from carosac_toolkit.cli.main import main
from carosac_toolkit.pictures.saving import PICTURE_FORMATS
from tests.calibration.self_calibration.scenes import csv_text, scene


@dataclass
class Options:
    robot: str | None = None
    output: Path | None = None
    report: Path | None = None
    seed: int = 0
    distance: tuple = ()
    x_through: str | None = None
    accuracy: float | None = None
    keeps_rotation: bool = False
    home_length_prior: float = 0.02
    radius_prior: float = 2e-3


@pytest.fixture
def angles_file(tmp_path):
    path = tmp_path / "angles.csv"
    path.write_text(csv_text(scene(3, blunders={(11, 1): 0.2})[3]))
    return path


def test_a_file_without_flags_gives_robot_report_and_numbers(angles_file, tmp_path, capsys):
    output, folder = tmp_path / "new.yaml", tmp_path / "report"
    result = run_motor_angles(Options(output=output, report=folder), angles_file)
    assert result.status == 0
    said = capsys.readouterr().out
    assert "24 samples of 4 motors, 6 known positions; robot hangprinter" in said
    assert "mm of line" in said and "left out as blunders" in said
    robot = ct.load_robot(str(output))
    write_json(tmp_path / "out.json", result.data)
    data = json.loads((tmp_path / "out.json").read_text())
    assert robot.exit_points[1, 0] == pytest.approx(
        data["parameters"]["exit_points[b].x"]["value"], abs=1e-9
    )
    assert robot.exit_covariance is not None and "drum_radius[d]" in robot.calibrated
    assert set(data["positions_m"]) == {str(k) for k in range(24)}
    assert data["blunders"] == [
        {"sample": "11", "what": "motor angles", "sigmas": data["blunders"][0]["sigmas"]}
    ]
    assert data["positions_sigma_m"]["11"] == [None, None, None]
    assert data["line_residual_rms_m"] > data["residual_rms_m"] > 0.0
    assert 0.0 < data["left_out"]["1"]["sigma_m"][0] < 0.01
    page = (folder / "report.html").read_text()
    assert "Known positions left out one at a time" in page and "motor angles left out" in page
    names = ("layout", "exit_points", "residuals", "learnt", "left_out")
    assert {path.name for path in folder.glob("[!.]*")} == {
        "report.html", *(f"{name}.{end}" for name in names for end in PICTURE_FORMATS)
    }  # fmt: skip


def test_a_calibrated_robot_calibrates_again_to_the_same(angles_file, tmp_path):
    output = tmp_path / "new.yaml"
    first = run_motor_angles(Options(output=output), angles_file)
    again = run_motor_angles(Options(robot=str(output)), angles_file)
    for name, one in again.data["parameters"].items():
        before = first.data["parameters"][name]
        assert abs(one["value"] - before["value"]) < 2.0 * before["sigma"], name


def test_a_robot_without_drums_or_with_other_cables_is_refused(angles_file):
    with pytest.raises(InvalidField, match="drum_radius: got unknown for robot 'scampi'"):
        run_motor_angles(Options(robot="scampi"), angles_file)
    text = angles_file.read_text().replace("motor_a_deg", "motor_x_deg")
    angles_file.write_text(text)
    with pytest.raises(InvalidField, match="--robot: got nothing; allowed: a robot file: no bundl"):
        run_motor_angles(Options(), angles_file)
    with pytest.raises(InvalidField, match="motors: got"):
        run_motor_angles(Options(robot="hangprinter"), angles_file)


@pytest.mark.parametrize("value", [0.0, np.inf, np.nan])
@pytest.mark.parametrize("option", ["home_length_prior", "radius_prior"])
def test_priors_that_are_none_are_refused_by_their_option(angles_file, option, value):
    name = f"--{option.replace('_', '-')}"
    with pytest.raises(InvalidField, match=rf"{name}: got .* m; allowed: a standard deviation > 0"):
        run_motor_angles(Options(**{option: value}), angles_file)


def test_outputs_are_refused_before_any_work(angles_file, tmp_path):
    with pytest.raises(CarosacError, match=r"--output: got .*\.yaml or \.yml"):
        run_motor_angles(Options(output=tmp_path / "new.txt"), angles_file)
    with pytest.raises(CarosacError, match="--report: got"):
        run_motor_angles(Options(report=angles_file), angles_file)


def test_the_bundled_robot_is_described_by_what_was_measured_by_hand():
    robot = ct.load_robot("hangprinter")
    distance = np.linalg.norm(robot.exit_points - robot.home_position, axis=1)
    assert distance == pytest.approx([1.597, 1.795, 1.5825, 2.355], abs=1e-4)
    at_home = robot.drum_radius**2 - robot.drum_advantage * robot.drum_buildup * distance
    assert np.sqrt(at_home) == pytest.approx(0.075, abs=1e-6)


def test_options_without_effect_on_motor_angles_are_refused(angles_file, capsys):
    words = ["calibrate", "lengths", str(angles_file)]
    assert main([*words, "--suggest-poses", "3"]) == 2
    error = capsys.readouterr().err
    assert "--suggest-poses: got 3; allowed: not with a file of motor angles" in error
    assert main([*words, "--exit-prior", "0.1"]) == 2
