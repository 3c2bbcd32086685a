from __future__ import annotations

import json

import pytest

from carosac_toolkit.base.errors import InvalidField, InvalidFile, MissingFile
from carosac_toolkit.studies import StudyConflict, read_cases, read_rows, run_cases
from carosac_toolkit.studies.run import case as case_module
from carosac_toolkit.studies.run.folder import opened
from carosac_toolkit.studies.run.row_files import merge_parts, part_files, read_part, write_part
from carosac_toolkit.studies.run.rows import make_row
from tests.studies.functions import one_case, some_cases

SCORE = "tests.studies.functions:score"
BEHAVE = "tests.studies.functions:behave"


def run(cases, folder, function=SCORE, **options):
    return run_cases(cases, function, folder=folder, workers=0, progress=False, **options)


def rows_of(count, **values):
    return [make_row(case, "ok", wall_time=0.0, values=values) for case in some_cases(count)]


def test_parts_keep_every_kind_of_value(tmp_path):
    values = {"whole": 3, "real": 0.1, "text": "läuft", "flag": True, "none": None, "big": 2**70}
    rows = rows_of(3, **values)
    rows[1] |= {"whole": "three", "flag": 0.5}
    path = write_part(tmp_path, rows)
    assert [{key: row[key] for key in rows[0]} for row in read_part(path)] == rows


def test_manifest_says_what_was_asked(tmp_path):
    cases = [*some_cases(3, duration=0.001), one_case("mpc", weights={"a": [1]})]
    run(cases, tmp_path)
    assert read_cases(tmp_path) == cases
    manifest = json.loads((tmp_path / "study.json").read_text())
    assert manifest["function"] == SCORE
    assert [entry[0] for entry in manifest["cases"]] == [case.identity for case in cases]


def test_a_study_can_grow(tmp_path):
    first = run(some_cases(3), tmp_path)
    assert run(some_cases(5), tmp_path)[:3] == first


def test_another_study_is_refused(tmp_path, monkeypatch):
    run(some_cases(3), tmp_path)
    with pytest.raises(StudyConflict, match=r"study: controllers: \w+ is missing here"):
        run([one_case("mpc")], tmp_path)
    with pytest.raises(StudyConflict, match=r"function: .*:score there, .*:behave here"):
        run(some_cases(3), tmp_path, BEHAVE)
    monkeypatch.setattr("carosac_toolkit.studies.run.folder.__version__", "99.0")
    with pytest.raises(StudyConflict, match=r"toolkit: .* there, 99\.0 here"):
        run(some_cases(3), tmp_path)
    with pytest.raises(InvalidFile, match="toolkit"):
        read_cases(tmp_path)


def test_settings_that_differ_from_the_study_of_a_folder_are_named(tmp_path):
    run([one_case("mpc", speed_max=1.0, weights={"sway": 2})], tmp_path)
    message = r"study: speed_max: 1\.0 there, 2\.0 here; weights\.sway: 2 there, none here\. Use"
    with pytest.raises(StudyConflict, match=message):
        run([one_case("mpc", speed_max=2.0)], tmp_path)


def test_settings_that_only_the_request_has_are_named(tmp_path):
    run([one_case("mpc", speed_max=1.0)], tmp_path)
    message = r"study: controller_settings\.gain: none there, 0\.5 here\. Use"
    with pytest.raises(StudyConflict, match=message):
        run([one_case("mpc", speed_max=1.0, controller_settings={"gain": 0.5})], tmp_path)


@pytest.mark.parametrize(("count", "words"), [(1, "1 of its cases is"), (2, "2 of its cases are")])
def test_cases_are_counted_where_no_name_or_setting_tells_them(tmp_path, count, words):
    cases = [
        one_case(name, seed) for name, seed in (("mpc", 0), ("mpc", 1), ("td3", 0), ("td3", 1))
    ]
    run(cases, tmp_path)
    with pytest.raises(StudyConflict, match=f"study: {words} missing here"):
        run([cases[0], cases[3], cases[1]][: 4 - count], tmp_path)


def test_only_what_is_missing_of_a_study_is_named(tmp_path):
    run([*some_cases(9), one_case("mpc"), one_case("td3", limits=list(range(99)))], tmp_path)
    with pytest.raises(StudyConflict) as caught:
        run([*some_cases(1), one_case("mpc")], tmp_path)
    text = str(caught.value)
    assert "controllers: td3 is missing here" in text and "mpc" not in text
    assert "seeds: 1, 2, 3 and 5 more are missing here" in text and len(text) < 320
    assert "limits: [0, 1, 2" in text and "there, none here" in text


def test_a_folder_serves_one_process_at_a_time(tmp_path):
    with opened(tmp_path, some_cases(3), SCORE):
        with pytest.raises(StudyConflict, match="another process"):
            run(some_cases(3), tmp_path)


def test_foreign_rows_are_left_alone(tmp_path):
    foreign = make_row(one_case("foreign"), "ok", wall_time=0.0)
    path = write_part(tmp_path, [foreign])
    before = path.read_bytes()
    assert len(run(some_cases(3), tmp_path)) == 3
    assert path.read_bytes() == before


def test_rows_that_are_there_twice_are_read_once(tmp_path):
    rows = run(some_cases(4), tmp_path)
    write_part(tmp_path, rows[1:3])  # a merge that was interrupted leaves this
    assert read_rows(tmp_path) == rows
    assert run(some_cases(4), tmp_path) == rows
    assert sum(len(read_part(path)) for path in part_files(tmp_path)) == 4


def test_merging_keeps_all_rows(tmp_path):
    rows = rows_of(6, rmse_m=0.5)
    for row in rows:
        write_part(tmp_path, [row])
    merge_parts(tmp_path, {str(row["case"]) for row in rows})
    (merged,) = part_files(tmp_path)
    assert sorted(read_part(merged), key=lambda row: row["seed"]) == rows


def test_a_broken_part_is_named(tmp_path):
    run(some_cases(3), tmp_path)
    (path,) = part_files(tmp_path)
    path.write_bytes(path.read_bytes()[:-100])
    for action in (lambda: read_rows(tmp_path), lambda: run(some_cases(3), tmp_path)):
        with pytest.raises(InvalidFile, match=rf"(?s){path.name}.*no whole Parquet.*delete it"):
            action()
    path.unlink()
    assert len(run(some_cases(3), tmp_path)) == 3


def test_left_overs_of_a_killed_run_go(tmp_path):
    (tmp_path / ".part-00000007-a1b2c3.parquet").write_bytes(b"half")
    (tmp_path / ".running-abc").mkdir()
    run(some_cases(1), tmp_path)
    assert sorted(x.name for x in tmp_path.iterdir()) == [
        ".lock", "part-00000000.parquet", "study.json"]  # fmt: skip


def test_no_study_and_broken_manifests_are_named(tmp_path):
    with pytest.raises(MissingFile, match=r"study\.json.*no folder of a study"):
        read_rows(tmp_path)
    (tmp_path / "study.json").write_text("{")
    with pytest.raises(InvalidFile, match="no JSON"):
        read_rows(tmp_path)
    (tmp_path / "study.json").write_text('{"schema": "other/1"}')
    with pytest.raises(InvalidFile, match=r"schema: got 'other/1'"):
        read_rows(tmp_path)
    (tmp_path / "study.json").write_text('{"schema": "carosac-study/1", "toolkit": "0.1.0"}')
    with pytest.raises(InvalidFile, match=r"cases: got None; allowed: a list"):
        read_rows(tmp_path)


def test_failed_cases_run_again_only_on_request(tmp_path, monkeypatch):
    cases = [one_case("good"), one_case("raises")]
    rows = run(cases, tmp_path, BEHAVE)
    assert [row["status"] for row in rows] == ["ok", "failed"]
    monkeypatch.setitem(
        __import__("tests.studies.functions").studies.functions.BEHAVIOURS,
        "raises",
        lambda case: {"rmse_m": 1.0},
    )
    assert run(cases, tmp_path, BEHAVE) == rows
    again = run(cases, tmp_path, BEHAVE, retry=["failed"])
    assert [row["status"] for row in again] == ["ok", "ok"]
    assert again[0]["wall_time_s"] == rows[0]["wall_time_s"]
    with pytest.raises(InvalidField, match=r"retry: got 'ok'"):
        run(cases, tmp_path, BEHAVE, retry=["ok"])


def test_old_versions_of_cases_keep_their_rows_apart(tmp_path, monkeypatch):
    run(some_cases(2), tmp_path)
    old = {row["case"] for row in read_rows(tmp_path)}
    monkeypatch.setattr(case_module, "__version__", "99.0")
    assert old.isdisjoint(case.identity for case in some_cases(2))
