"""The reference suite: what it fixes, who enters, and results compared only with their like."""

import json
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.reference import check
from carosac_toolkit import trajectories
from carosac_toolkit.base.errors import InvalidField, InvalidFile
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.robot.file import load_robot
from carosac_toolkit.studies.compare.resampling import holm, smallest_p
from carosac_toolkit.studies.compare.results import StudyResults
from carosac_toolkit.studies.reference.cases import LATEST_SUITE, ReferenceSuite, suites
from carosac_toolkit.studies.reference.check import agreement
from carosac_toolkit.studies.reference.results import (
    RECORD,
    RESULTS,
    OtherSuite,
    PartResults,
    check_same,
    read_rows,
    record,
    tables,
    with_published,
    write_rows,
)

SUITE = ReferenceSuite.load("reference")


def test_the_definition_has_not_changed_under_its_name():
    """A change of the suite, of its robots or of its condition needs a new version."""
    assert SUITE.name == LATEST_SUITE == suites()[-1]
    assert SUITE.digest == "70942b8d9daa7d52"


def test_the_digest_is_of_all_that_decides_the_draws():
    seeds = replace(SUITE, definition={**SUITE.definition, "seeds": [0, 1, 2]})
    robots = replace(SUITE, definition={**SUITE.definition, "robots": ["carosac"]})
    assert len({SUITE.digest, SUITE.quick().digest, seeds.digest, robots.digest}) == 4
    assert replace(SUITE, definition=dict(SUITE.definition)).digest == SUITE.digest


def test_its_seeds_can_show_what_it_compares():
    for task in SUITE.tasks():
        others = len(task.study.controllers) * len(task.study.estimators) - 1
        assert holm([smallest_p(len(task.study.seed_list))] * others)[0] <= 0.05


def test_all_of_ours_run_and_a_policy_only_on_its_robot():
    ways = {(t.part, t.robot): (t.study.controllers, t.study.estimators) for t in SUITE.tasks()}
    assert ways["tracking", "carosac"][0][-1] == "td3"
    assert "td3" not in ways["tracking", "scampi"][0] and "mpc" in ways["tracking", "scampi"][0]
    assert "ks_ekf" in ways["estimation", "scampi"][1]
    for task in SUITE.tasks():
        task.study.check()
        assert task.study.seed_list == (0, 1, 3, 4, 5, 6, 7, 8) and task.study.speed_max == 2.0
        assert task.study.driver_settings["cables"] == "particles"


def test_robots_can_rest_along_all_its_paths():
    """Otherwise controllers that refuse such a path lose it for nothing."""
    for task in SUITE.tasks(controllers=["straight_line"]):
        robot, cases = load_robot(task.robot), task.study.cases()
        paths = {(case.trajectory, case.path_seed % 2**32) for case in cases}
        points = []
        for name, seed in paths:
            path = trajectories.build(name, robot, seed, speed_max=2.0, acceleration_max=2.0)
            points.append(path.sample(np.linspace(0.0, path.duration, 25)).position)
        rest = statics.inverse_kinematics(robot, np.concatenate(points))
        assert len(paths) == 24 and (rest.converged & rest.stable).all()


def test_an_entry_runs_beside_the_baseline_only_and_on_the_same_draws():
    entered = SUITE.tasks(controllers=["mine:Controller"])
    assert [(t.part, t.robot) for t in entered] == [("tracking", "carosac"), ("tracking", "scampi")]
    assert entered[0].study.controllers == ("kinematic_solver", "mine:Controller")
    whole = {task.robot: task for task in SUITE.tasks() if task.part == "tracking"}
    for task in entered:
        seeds = [{(c.plant_seed, c.path_seed, c.sensor_seed) for c in t.study.cases()}
                 for t in (task, whole[task.robot])]  # fmt: skip
        assert seeds[0] == seeds[1]
    assert [t.robot for t in SUITE.tasks(controllers=["td3"])] == ["carosac"]
    both = SUITE.tasks(controllers=["mpc"], estimators=["ks_ekf"])
    assert {t.part for t in both} == {"tracking", "estimation"}


def test_settings_reach_the_plug_in_that_they_are_of():
    chosen = {"mine": {"gain": 2}}
    entered = SUITE.tasks(controllers=["mine"], controller_settings=chosen, workers=0)
    assert entered[0].study.controller_settings == chosen and entered[0].study.workers == 0
    other = SUITE.tasks(estimators=["ks_ekf"], controller_settings=chosen)[0]
    assert other.study.controller_settings == {}


def test_a_suite_that_is_not_there():
    with pytest.raises(
        InvalidField, match=r"suite: got 'lengths'.*sensors are chosen with --sensors"
    ):
        ReferenceSuite.load("lengths")


def part_of(scales, folder, *, seeds=4):
    """Made-up rows of the part `tracking` on carosac, errors by controller."""
    task = SUITE.tasks(controllers=list(scales))[0]
    rows = []
    for name, scale in scales.items():
        for seed in range(seeds):
            for k, path in enumerate(SUITE.definition["trajectories"]):
                error = scale * (0.05 + 0.01 * np.sin(3.0 * seed + k))
                rows.append({
                    "robot": "carosac", "controller": name, "estimator": "dynamic_estimator",
                    "sensors": "lengths+imu", "perturbation": "nominal-1", "trajectory": path,
                    "seed": seed, "status": "ok", "reason": None, "settings": "{}",
                    "tracking_rmse_norm_m": error, "steps": 100, "centre_steps": 40,
                    "tracking_centre_m": error, "tracking_boundary_m": error,
                    "residual_sway_m": error, "estimation_rmse_norm_m": error,
                    "latency_median_s": 1e-3, "latency_p95_s": 1e-3, "latency_p99_s": 1e-3,
                })  # fmt: skip
    return PartResults(task=task, results=StudyResults(rows=tuple(rows), folder=folder))


def written(part, folder, suite=SUITE):
    folder.mkdir()
    (folder / RESULTS).write_text(write_rows([part]))
    (folder / RECORD).write_text(json.dumps(record(suite, [part], {}, "command")))
    return folder


def test_rows_survive_the_file_within_their_digits(tmp_path):
    part = part_of({"kinematic_solver": 1.0, "mpc": 0.2}, tmp_path)
    back = read_rows(written(part, tmp_path / "a"))
    assert len(back) == len(part.rows) == 24
    for one, other in zip(part.rows, back, strict=True):
        assert other["tracking_rmse_norm_m"] == pytest.approx(one["tracking_rmse_norm_m"], rel=1e-5)
        assert {k: other[k] for k in ("part", "seed", "status", "reason")} == {
            k: one[k] for k in ("part", "seed", "status", "reason")
        }
        assert other["orientation_rmse_rad"] is None


def test_results_of_another_definition_are_refused(tmp_path):
    part = part_of({"kinematic_solver": 1.0, "mpc": 0.2}, tmp_path)
    other = written(part, tmp_path / "quick", SUITE.quick())
    with pytest.raises(OtherSuite, match=r"reference-1-quick .*cannot be compared"):
        check_same(SUITE, other)
    check_same(SUITE, written(part, tmp_path / "same"))


def test_an_entry_is_compared_with_what_was_published(tmp_path):
    published = written(
        part_of({"kinematic_solver": 1.0, "mpc": 0.2, "td3": 0.6}, tmp_path, seeds=8),
        tmp_path / "p",
    )
    mine = part_of({"kinematic_solver": 1.0, "mine": 0.5}, tmp_path, seeds=8)
    shown = with_published(mine, read_rows(published))
    block = shown.blocks[0]
    labels = ["kinematic_solver", "mine", "mpc (published)", "td3 (published)"]
    assert [one.label for one in block.compared] == labels
    assert block.baseline == "kinematic_solver"
    assert [sorted(one.best) != [] for one in block.compared] == [False, False, True, False]
    text = tables(SUITE, [shown], "origin")
    assert SUITE.digest in text and "mpc (published)" in text


def test_agreement_is_within_a_tolerance_and_names_what_is_not(tmp_path):
    scales = {"kinematic_solver": 1.0, "mpc": 0.2}
    there = written(part_of(scales, tmp_path), tmp_path / "there")
    near = written(part_of({"kinematic_solver": 1.04, "mpc": 0.2}, tmp_path), tmp_path / "near")
    far = written(part_of({"kinematic_solver": 1.2, "mpc": 0.2}, tmp_path), tmp_path / "far")
    assert check(there, there) == check(near, there) == []
    faults = check(far, there)
    assert len(faults) == 5 and all("kinematic_solver with dynamic" in text for text in faults)
    assert "published 50" in faults[0]
    few = written(part_of({"kinematic_solver": 1.0}, tmp_path), tmp_path / "few")
    assert "missing" in check(few, there)[-1]


def test_a_case_that_failed_in_one_run_only_is_named(tmp_path):
    part = part_of({"kinematic_solver": 1.0}, tmp_path)
    rows = [dict(row) for row in part.rows]
    rows[3] |= {"status": "failed", "reason": "why"}
    found = agreement(rows, part.rows)
    assert len(found.failures) == 1 and "seed 1: failed, published ok" in found.failures[0]


def test_a_case_that_was_left_out_is_named(tmp_path):
    """Whoever leaves out the cases that went wrong does not agree."""
    part = part_of({"kinematic_solver": 1.0}, tmp_path)
    fewer = agreement(part.rows[1:], part.rows).failures
    assert len(fewer) == 1 and "seed 0: not there, published ok" in fewer[0]
    more = agreement(part.rows, part.rows[1:]).failures
    assert len(more) == 1 and "seed 0: ok, published not there" in more[0]


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        (lambda text: text.replace(",ok,", ",fine,", 1), r"line 2, status: got 'fine'; allowed"),
        (
            lambda text: text.replace("0.05,", "nan,", 1),
            r"line 2, tracking_\w+: got 'nan'; allowed",
        ),
        (lambda text: text.replace(",0,ok", ",x,ok", 1), r"line 2, seed: got 'x'; allowed"),
        (lambda text: text[: text.rindex(",ok,")], r"line 25, status: got nothing; allowed"),
        (lambda text: text.replace("seed,", "", 1), r"header: got no seed; allowed"),
        (lambda text: "", r"header: got no part"),
    ],
)
def test_a_damaged_file_of_results_says_where(tmp_path, change, fault):
    folder = written(part_of({"kinematic_solver": 1.0}, tmp_path, seeds=8), tmp_path / "a")
    path = folder / RESULTS
    path.write_text(change(path.read_text()))
    with pytest.raises(InvalidFile, match=fault):
        read_rows(folder)


def test_a_record_without_its_digest_is_refused(tmp_path):
    (tmp_path / RECORD).write_text(json.dumps({"schema": "carosac-reference/1", "suite": "a"}))
    with pytest.raises(InvalidFile, match=r"digest: got None; allowed: a text"):
        check_same(SUITE, tmp_path)
