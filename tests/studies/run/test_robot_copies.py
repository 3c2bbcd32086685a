"""A study keeps the robots it was run with, wherever their files go."""

from __future__ import annotations

import shutil

import numpy as np
import pytest

import carosac_toolkit as ct
from carosac_toolkit.base.errors import CarosacError
from carosac_toolkit.robot.file import robot_path, robot_text
from carosac_toolkit.studies.run.robot_copies import ROBOTS_FOLDER, copy_of
from carosac_toolkit.viewer.runs import load_runs


def test_a_study_is_viewed_after_its_robot_file_has_changed_and_moved(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    shutil.copy(robot_path("carosac"), "mine.yaml")
    results = ct.Study(
        robots=["mine.yaml"], controllers=["straight_line"], trajectories=["line"], seeds=1,
        driver="quasi_static", workers=0, output="out",
    ).run(progress=False)  # fmt: skip
    copy = copy_of(results.folder, results.rows[0])
    assert copy is not None and copy.parent.name == ROBOTS_FOLDER
    assert copy.read_text() == robot_text("carosac")
    text = robot_text("carosac").replace("mass: 23.655 kg", "mass: 99 kg")
    (tmp_path / "mine.yaml").write_text(text)
    (run,) = load_runs("out")
    assert run.robot.mass == pytest.approx(23.655)
    (tmp_path / "mine.yaml").unlink()
    shutil.move("out", tmp_path / "moved")
    monkeypatch.chdir("/")
    (run,) = load_runs(str(tmp_path / "moved"))
    assert np.array_equal(run.robot.exit_points, ct.load_robot("carosac").exit_points)
    shutil.rmtree(tmp_path / "moved" / ROBOTS_FOLDER)  # as in a study of an earlier version
    with pytest.raises(CarosacError, match="keeps no copy of this robot"):
        load_runs(str(tmp_path / "moved"))
