"""Studies outlive what happens to their processes, and leave none behind."""

from __future__ import annotations

import os
import signal
import sys
import weakref

import pytest

from carosac_toolkit.studies import read_rows, run_cases
from carosac_toolkit.studies.run.row_files import part_files, read_part
from tests.studies.functions import one_case, some_cases, without_times
from tests.studies.processes import alive, descendants, start, wait_until, workers_of

SCORE = "tests.studies.functions:score"


def test_a_killed_driver_leaves_no_process_and_its_study_goes_on(tmp_path):
    folder = tmp_path / "study"
    cases = some_cases(60, duration=0.1)
    driver = start(folder, "some_cases(60, duration=0.1)", "score")
    wait_until(lambda: len(part_files(folder)) > 0)
    family = descendants(driver)
    os.kill(family[-1].pid, signal.SIGKILL)  # one worker first
    wait_until(lambda: len(part_files(folder)) > 1)
    family += [x for x in descendants(driver) if x not in family]
    driver.kill()
    driver.communicate(timeout=20)
    wait_until(lambda: alive(family) == [])
    before = read_rows(folder)
    assert 0 < len(before) < 60
    rows = run_cases(cases, SCORE, folder=folder, workers=2, progress=False)
    assert [row for row in rows if row in before] == before
    on_disk = [row["case"] for path in part_files(folder) for row in read_part(path)]
    assert sorted(on_disk) == sorted(case.identity for case in cases)
    quick = run_cases(some_cases(60), SCORE, folder=tmp_path / "quick", workers=0, progress=False)
    settled = [row | {"case": None, "settings": None} for row in without_times(rows)]
    assert settled == [row | {"case": None, "settings": None} for row in without_times(quick)]


@pytest.mark.skipif(sys.platform != "linux", reason="Linux alone ends such processes")
def test_workers_stuck_in_compiled_code_go_with_their_driver(tmp_path):
    driver = start(tmp_path / "study", "[one_case('seizes', i) for i in range(2)]", "behave")
    wait_until(lambda: len(list(tmp_path.glob("study/.running-*/*"))) == 2)
    family = descendants(driver)
    assert len(workers_of(driver)) == 2
    driver.kill()
    driver.communicate(timeout=20)
    wait_until(lambda: alive(family) == [], 5.0)


def test_ctrl_c_keeps_the_rows_and_closes_the_workers(tmp_path):
    folder = tmp_path / "study"
    driver = start(folder, "some_cases(200, duration=0.1)", "score")
    wait_until(lambda: len(part_files(folder)) > 0)
    family = descendants(driver)
    os.killpg(driver.pid, signal.SIGINT)  # as a terminal does: to all of them
    output, errors = driver.communicate(timeout=20)
    assert output == "the script runs\n"  # once: workers do not run it again
    assert "study: interrupted; the same call runs the rest" in errors
    assert errors.count("Traceback") == 1
    assert errors.rstrip().endswith("KeyboardInterrupt")
    wait_until(lambda: alive(family) == [])
    assert len(read_rows(folder)) > 0


def test_ctrl_c_is_heard_where_python_loses_its_error(tmp_path, capfd):
    """As in callbacks of weak references, which dask uses."""

    class Dropped:
        pass

    def lost():
        if shown:
            dropped = Dropped()
            seen.append(weakref.ref(dropped, lambda _: signal.raise_signal(signal.SIGINT)))
            del dropped
        shown.append(0.1)
        return 0.1

    shown, seen = [], []
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt):
            run_cases(some_cases(200, duration=0.1), SCORE, folder=tmp_path, workers=1, share=lost)
    finally:
        signal.signal(signal.SIGINT, before)
    assert "study: interrupted; the same call runs the rest" in capfd.readouterr().err
    assert 0 < len(read_rows(tmp_path)) < 200


def test_one_process_is_interrupted_as_well(tmp_path):
    folder = tmp_path / "study"
    driver = start(folder, "some_cases(200, duration=0.1)", "score", "workers=0")
    wait_until(lambda: len(part_files(folder)) > 0)
    driver.send_signal(signal.SIGINT)
    _, errors = driver.communicate(timeout=20)
    assert "interrupted" in errors
    assert {row["status"] for row in read_rows(folder)} == {"ok"}


@pytest.mark.slow
def test_a_worker_that_dies_again_and_again_is_started_again_and_again(tmp_path):
    dying = 18.0  # [s] dask looks 15 s after a worker's death whether it is there, by default
    case = one_case("dies again and again", folder=str(tmp_path), dying=dying)
    rows = run_cases(
        [case], "tests.studies.functions:behave", folder=tmp_path / "study", workers=1,
        attempts=1000, progress=False,
    )  # fmt: skip
    assert [row["status"] for row in rows] == ["ok"]


def test_a_case_that_kills_a_lone_process_is_not_run_in_it_when_others_are_done(tmp_path):
    cases = [*some_cases(5), one_case("dies")]
    rows = run_cases(
        cases, "tests.studies.functions:behave", folder=tmp_path, progress=False, attempts=1
    )
    assert [row["status"] for row in rows] == ["ok"] * 5 + ["crashed"]
    again = run_cases(
        cases, "tests.studies.functions:behave", folder=tmp_path, progress=False, attempts=1,
        retry=["crashed"],
    )  # fmt: skip
    assert [row["status"] for row in again] == ["ok"] * 5 + ["crashed"]
