from __future__ import annotations

import json
import re
import shlex
from pathlib import Path

import numpy as np
import pytest

from calibration.tachymeter.csv_file import read_csv
from calibration.tachymeter.synthetic import write_gsi, write_targets
from calibration.tachymeter.targets import read_targets
from carosac_toolkit import load_robot
from carosac_toolkit.cli.main import main
from carosac_toolkit.pictures.saving import PICTURE_FORMATS
from tests.calibration.tachymeter.scenes import drawn, write


@pytest.fixture
def site(tmp_path, monkeypatch):
    scene = drawn(3, blunders=0.05)
    write_gsi(tmp_path, scene.survey, long=True)
    write_targets(tmp_path / "targets.yaml", scene.survey)
    monkeypatch.chdir(tmp_path)
    return scene


def words(*more):
    return ["calibrate", "tachymeter", "A.gsi", "B.gsi", "--robot", "carosac", "--targets",
            "targets.yaml", *more]  # fmt: skip


def test_a_survey_becomes_a_robot_file_with_covariances(site, tmp_path, capsys):
    assert main(words("--output", "new.yaml", "--report", "report", "--json", "out.json")) == 0
    robot = load_robot(tmp_path / "new.yaml")
    off = robot.exit_points - site.truth.exit_points
    assert np.linalg.norm(off, axis=1).max() < 2e-3
    assert robot.exit_covariance is not None
    whitened = [o @ np.linalg.solve(c, o) for o, c in zip(off, robot.exit_covariance, strict=True)]
    assert max(whitened) < 20.0
    data = json.loads((tmp_path / "out.json").read_text())
    assert data["exit_points_m"]["front_left"] == pytest.approx(robot.exit_points[0])
    assert np.shape(data["covariance_m2"]) == (12, 12)
    named = {(b["shot"] - 1, b["reading"]) for b in data["blunders"]}
    assert named == {(i, ("Hz", "V", "distance")[c]) for i, c, _ in site.wrong}
    assert set(data["residual_rms"]) == {"Hz_rad", "V_rad", "distance_m"}
    assert "exit_points[front_left].x" in data["parameters"]
    printed = capsys.readouterr().out
    assert "WARNING: left out: shot" in printed and "chi2" in printed
    report = tmp_path / "report"
    names = {f"{x}.{end}" for x in ("site", "exit_points", "shots") for end in PICTURE_FORMATS}
    assert {path.name for path in report.glob("[!.]*")} == {"report.html", *names}
    page = (report / "report.html").read_text()
    assert "carosac calibrate tachymeter A.gsi B.gsi" in page and "[A.gsi" in page


def test_the_old_robot_file_is_never_overwritten(site, tmp_path, capsys):
    from carosac_toolkit.robot.file import robot_text

    old = tmp_path / "mine.yaml"
    old.write_text(robot_text("carosac"))
    arguments = ["calibrate", "tachymeter", "A.gsi", "--robot", "mine.yaml", "--targets",
                 "targets.yaml", "--output", "mine.yaml"]  # fmt: skip
    assert main(arguments) == 2
    assert old.read_text() == robot_text("carosac")
    assert "--output" in capsys.readouterr().err


def test_residuals_beyond_the_stated_accuracy_end_in_status_one(site, tmp_path, capsys):
    text = (tmp_path / "targets.yaml").read_text()
    text = text.replace("angle_arcsec: 3", "angle_arcsec: 0.3")
    text = text.replace("pointing_mm: 0.3", "pointing_mm: 0.03")
    (tmp_path / "targets.yaml").write_text(text)
    assert main(words()) == 1
    assert "times larger than the stated accuracy explains" in capsys.readouterr().out


def test_one_bad_line_is_one_clear_message(site, tmp_path, capsys):
    lines = (tmp_path / "A.gsi").read_text().splitlines()
    (tmp_path / "A.gsi").write_text("\n".join([*lines[:-1], lines[-1][:60]]))
    assert main(words("--output", "new.yaml")) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"carosac: A.gsi: 1 fault\n  line {len(lines)}: cut off or damaged")
    assert not (tmp_path / "new.yaml").exists()


def test_no_files_and_odd_tilts_are_refused(site, capsys):
    assert main(words("--frame-tilt-deg", "90")) == 2
    assert "--frame-tilt-deg" in capsys.readouterr().err


def test_what_the_docs_show_runs(tmp_path, monkeypatch):
    root = Path(__file__).resolve().parents[3]
    text = (root / "docs" / "calibration-tachymeter.md").read_text(encoding="utf-8")

    def blocks(kind):
        return re.findall(rf"```{kind}\n(.*?)```", text, re.DOTALL)

    monkeypatch.chdir(tmp_path)
    (program,) = blocks("python")
    exec(program, {})
    for block in blocks("bash"):
        for line in block.replace("\\\n", " ").splitlines():
            assert main(shlex.split(line)[1:]) == 0, line
    (targets,) = blocks("yaml")
    read_targets(write(tmp_path, "t.yaml", targets), load_robot("carosac"))
    (csv,) = (block for block in blocks("text") if "setup,target" in block)
    assert len(read_csv(write(tmp_path, "c.csv", csv))) == 2


def test_what_would_count_twice_or_as_one_set_up_is_refused(site, tmp_path, capsys):
    (tmp_path / "other").mkdir()
    (tmp_path / "B.gsi").rename(tmp_path / "other" / "A.gsi")
    targets = ["--robot", "carosac", "--targets", "targets.yaml"]
    start = ["calibrate", "tachymeter", "A.gsi"]
    assert main([*start, "other/A.gsi", *targets]) == 2
    assert "set-ups called otherwise than in 'A.gsi', which has a 'A'" in capsys.readouterr().err
    assert main([*start, "other/../A.gsi", *targets]) == 2
    assert "FILE: got 'other/../A.gsi'; allowed: each file once" in capsys.readouterr().err
    write(tmp_path, "s.csv", "setup,target,hz_gon,v_gon,slope_m\nA,R1,1,100,5\n")
    assert main([*start, "s.csv", *targets]) == 2
    assert "set-ups called otherwise than in 'A.gsi'" in capsys.readouterr().err
