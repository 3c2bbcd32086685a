from __future__ import annotations

import os
import socket
import ssl
import stat
import sys
import tempfile
from contextlib import nullcontext, suppress
from pathlib import Path

import psutil
import pytest
from distributed import Client, Security

from carosac_toolkit.base.errors import CarosacError, InvalidField
from carosac_toolkit.studies import UnfitWorker, read_rows, run_cases
from carosac_toolkit.studies.run.batching import Batching
from carosac_toolkit.studies.run.cluster import SINGLE_THREAD_ENVIRONMENT, local_client
from carosac_toolkit.studies.run.execution import WorkerTask, rows_of
from tests.another_user import as_another_user, as_root
from tests.studies.functions import one_case, some_cases, without_times
from tests.studies.processes import cluster

MODULE = "tests.studies.functions"


def run(cases, folder, function="score", **options):
    return run_cases(cases, f"{MODULE}:{function}", folder=folder, progress=False, **options)


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    return run(some_cases(60), tmp_path_factory.mktemp("study"), workers=0)


def test_rows_follow_the_cases(undisturbed):
    assert [row["seed"] for row in undisturbed] == list(range(60))
    assert {row["status"] for row in undisturbed} == {"ok"}
    assert undisturbed[3]["label"] == "seed 3"
    assert {type(row["often_whole"]) for row in undisturbed} == {float}
    assert {type(row["count"]) for row in undisturbed} == {int}


def test_workers_give_the_same_rows_as_one_process(undisturbed, tmp_path):
    assert without_times(run(some_cases(60), tmp_path, workers=2)) == without_times(undisturbed)


def test_a_second_call_runs_only_what_is_missing(undisturbed, tmp_path):
    log = tmp_path / "log"
    cases = some_cases(12, log=str(log))
    first = run(cases[:5], tmp_path / "study", "log_and_score", workers=0)
    rows = run(cases, tmp_path / "study", "log_and_score", workers=2)
    again = run(cases, tmp_path / "study", "log_and_score", workers=2)
    assert rows[:5] == first
    assert again == rows
    ran = [line.split() for line in log.read_text().splitlines()]
    assert sorted(identity for identity, _ in ran) == sorted(case.identity for case in cases)
    assert [row["rmse_m"] for row in rows] == [row["rmse_m"] for row in undisturbed[:12]]


def test_cases_that_are_asked_for_again_run_again(tmp_path):
    log = tmp_path / "log"
    cases = some_cases(3, log=str(log))
    run(cases, tmp_path / "study", "log_and_score", workers=0)
    some = [cases[1].identity, "of no case"]
    run(cases, tmp_path / "study", "log_and_score", workers=0, again=some)
    ran = [line.split()[0] for line in log.read_text().splitlines()]
    assert ran == [*(case.identity for case in cases), cases[1].identity]


@pytest.mark.parametrize("workers", [0, 2])
def test_cases_leave_files_of_their_own(tmp_path, monkeypatch, workers):
    monkeypatch.chdir(tmp_path)
    rows = run(some_cases(2), "study", "leave_a_file", workers=workers, own_files=True)
    assert [row["status"] for row in rows] == ["ok", "ok"]
    for seed in range(2):
        assert (tmp_path / "study" / f"{seed}.txt").read_text() == f"seed {seed}"


def test_files_of_cases_that_run_together_are_nobodys(tmp_path):
    batching = Batching(group=f"{MODULE}:score", function=f"{MODULE}:score", size=2)
    with pytest.raises(InvalidField, match="batching"):
        run(some_cases(2), tmp_path, "leave_a_file", own_files=True, batching=batching)


def test_a_machine_without_the_folder_says_so(tmp_path):
    case = some_cases(1)[0]
    task = WorkerTask(
        cases=(case.to_dict(),), identities=(case.identity,), function=f"{MODULE}:leave_a_file",
        together="", timeout=10.0, attempts=1, notes="", own_folder=str(tmp_path / "elsewhere"),
    )  # fmt: skip
    (row,) = rows_of(task)
    assert row["status"] == "failed"
    assert "elsewhere is not on this machine" in row["reason"]


def test_a_handful_of_cases_starts_no_process(tmp_path):
    cases = some_cases(4, log=str(tmp_path / "log"))
    run(cases, tmp_path / "study", "log_and_score")
    pids = {line.split()[1] for line in (tmp_path / "log").read_text().splitlines()}
    assert pids == {str(os.getpid())}


def test_bad_cases_cost_only_themselves(tmp_path):
    bad = ["raises", "nan", "leaves", "loops", "hangs", "seizes", "dies", "faults", "dies once"]
    cases = some_cases(30)
    for i, name in enumerate(bad):
        cases.insert(3 * i + 1, one_case(name, folder=str(tmp_path)))
    rows = run(cases, tmp_path / "study", "behave", workers=2, timeout=0.5)
    found = {row["controller"]: (row["status"], row["reason"]) for row in rows}
    died = "its process died 3 times: "
    ended = "did not stop after 0.5 s; its process was ended in "
    assert found == {
        "good": ("ok", None),
        "dies once": ("ok", None),
        "raises": ("failed", "ValueError: no such pose"),
        "leaves": ("failed", "SystemExit: 3"),
        "nan": ("failed", "BadRow: row field 'rmse_m': got nan; "
                "allowed: a finite number, text, true/false or None"),
        "loops": ("timed_out", "stopped after 0.5 s"),
        "hangs": ("timed_out", ended + found["hangs"][1].partition(ended)[2]),
        "seizes": ("timed_out", ended + found["seizes"][1].partition(ended)[2]),
        "dies": ("crashed", died + "without a message: killed, out of memory, or left by os._exit"),
        "faults": ("crashed", died + "Segmentation fault in string_at "
                   + found["faults"][1].partition("string_at ")[2]),
    }  # fmt: skip
    assert "_seize (functions.py" in found["seizes"][1]
    assert sum(row["status"] == "ok" for row in rows) == 31
    assert not list((tmp_path / "study").glob(".running-*"))


def test_a_case_may_bring_its_own_limit(tmp_path):
    (row,) = run([one_case("loops", timeout=0.1)], tmp_path, "behave")
    assert (row["status"], row["reason"]) == ("timed_out", "stopped after 0.1 s")


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_workers_are_alone_single_threaded_and_local(monkeypatch):
    for name in SINGLE_THREAD_ENVIRONMENT:
        monkeypatch.setenv(name, "2")  # workers do not have it from here
    environment = dict(os.environ)
    with local_client(2) as client:
        found = client.run(dict, os.environ)
        connections = psutil.Process().net_connections()
        for pid in client.run(os.getpid).values():
            connections += psutil.Process(pid).net_connections()
    assert all(x.items() >= SINGLE_THREAD_ENVIRONMENT.items() for x in found.values())
    listening = {x.laddr.ip for x in connections if x.status == psutil.CONN_LISTEN}
    assert listening == {"127.0.0.1"}
    assert os.environ.items() - environment.items() <= {
        (name, os.environ.get(name)) for name in ("PYTHONHASHSEED", "__DASK_PARENT_PID")
    }  # dask's own marks for its children


@as_root
def test_no_module_of_another_user_is_imported(monkeypatch):
    """Neither by workers, begun anew or not, nor by this process, then or later."""
    with tempfile.TemporaryDirectory() as shared:
        Path(shared).chmod(0o1777)
        monkeypatch.setattr(tempfile, "tempdir", shared)
        monkeypatch.setenv("TMPDIR", shared)
        trap = Path(shared, "dask-scratch-space")

        def prepare():
            trap.mkdir(mode=0o777)
            (trap / "wave.py").write_text("raise AssertionError('code of another user')")

        assert as_another_user(prepare) is None
        before = list(sys.path)
        with local_client(1) as client:
            (folder,) = set(Path(shared).iterdir()) - {trap}
            assert stat.S_IMODE(folder.stat().st_mode) == 0o700
            for _ in range(2):
                (path,) = client.run(lambda: __import__("wave") and __import__("sys").path).values()
                for entry in {*path, *sys.path} - set(before):
                    assert Path(entry).is_relative_to(folder / "dask-scratch-space")
                client.restart()
        assert sys.path == before
        assert list(Path(shared).iterdir()) == [trap]


@as_root
def test_another_user_is_refused_at_every_port_of_a_study():
    anybody = ssl.create_default_context()
    anybody.check_hostname, anybody.verify_mode = False, ssl.CERT_NONE

    def knock():
        answers = []
        for port in ports:
            for wrap in (lambda connection: connection, anybody.wrap_socket):
                with suppress(OSError), socket.socket() as plain:
                    plain.settimeout(5.0)
                    plain.connect(("127.0.0.1", port))
                    with wrap(plain) as connection:
                        connection.sendall(bytes(16))
                        answers.append(connection.recv(1))
        return answers

    with local_client(2) as client:
        processes = [psutil.Process(), *psutil.Process().children(recursive=True)]
        connections = [x for process in processes for x in process.net_connections()]
        ports = {x.laddr.port for x in connections if x.status == psutil.CONN_LISTEN}
        assert len(ports) == 5  # the scheduler, two workers and their two nannies
        assert set(as_another_user(knock)) <= {b""}  # closed without a word
        stranger = Security.temporary()
        with pytest.raises(OSError), Client(client.scheduler.address, security=stranger, timeout=2):
            pass


def test_a_scheduler_in_another_process_gives_the_same_rows(undisturbed, tmp_path):
    with cluster(workers=2) as dask:
        cases = [*some_cases(60), one_case("dies"), one_case("hangs")]
        rows = run(cases, tmp_path, "behave", scheduler=dask.address, timeout=0.3)
    assert without_times(rows[:60]) == without_times(undisturbed)
    assert [row["status"] for row in rows[60:]] == ["crashed", "timed_out"]


def test_on_a_file_system_of_their_own_suspects_run_alone(undisturbed, tmp_path, monkeypatch):
    nowhere = nullcontext(str(tmp_path / "not there"))
    monkeypatch.setattr("carosac_toolkit.studies.run.engine.notes_folder", lambda path: nowhere)
    with cluster(workers=2) as dask:
        cases = [one_case("dies"), *some_cases(20)]
        rows = run(cases, tmp_path / "study", "behave", scheduler=dask.address)
    assert (rows[0]["status"], rows[0]["reason"][:25]) == ("crashed", "its process died 4 times:")
    assert without_times(rows[1:]) == without_times(undisturbed[:20])


def test_workers_that_share_a_process_are_refused(tmp_path):
    with cluster(threads=2) as dask:
        with pytest.raises(UnfitWorker, match=r"2 cases at once.*--nthreads 1"):
            run(some_cases(5), tmp_path, scheduler=dask.address)
    assert read_rows(tmp_path) == []


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"workers": -1}, r"workers: got -1"),
        ({"workers": 2, "scheduler": "tcp://127.0.0.1:1"}, "no number of workers with"),
        ({"scheduler": "nonsense://x"}, "scheduler: got 'nonsense://x'; allowed: address"),
        ({"timeout": 0.0}, r"timeout: got 0\.0 s"),
        ({"attempts": 0}, "attempts: got 0"),
    ],
)
def test_arguments_are_checked(options, match, tmp_path):
    with pytest.raises(InvalidField, match=match):
        run(some_cases(5), tmp_path, **options)


def test_cases_are_checked(tmp_path):
    with pytest.raises(InvalidField, match=r"cases\[1\]: got the same as cases\[0\]"):
        run([one_case("x"), one_case("x")], tmp_path)
    with pytest.raises(InvalidField, match="cases: got none"):
        run([], tmp_path)


@pytest.mark.parametrize(
    "function", ["score", ":score", "__main__:f", "no.such:f", f"{MODULE}:none", f"{MODULE}:NAMES"]
)
def test_functions_that_workers_cannot_import_are_refused(function, tmp_path):
    with pytest.raises(InvalidField, match=r"function: got .* any process can import"):
        run_cases(some_cases(1), function, folder=tmp_path)


def test_a_folder_that_is_a_file_is_an_error(tmp_path):
    (tmp_path / "x").touch()
    with pytest.raises((CarosacError, OSError)):
        run(some_cases(1), Path(tmp_path / "x"))


def test_a_case_that_diverged_keeps_its_numbers_and_its_reason(tmp_path):
    cases = some_cases(2)
    rows = run(cases, tmp_path, "diverge", workers=0)
    assert [row["status"] for row in rows] == ["ok", "diverged"]
    assert [row["reason"] for row in rows] == [None, "the platform left"]
    assert [row["error"] for row in rows] == [1.0, 1.0] and "diverged" not in rows[0]
    first = rows[1]["wall_time_s"]
    assert run(cases, tmp_path, "diverge", workers=0)[1]["wall_time_s"] == first
    again = run(cases, tmp_path, "diverge", workers=0, retry=["diverged"])
    assert again[1]["wall_time_s"] != first
