"""A study whose scheduler or workers have gone says so, ends, and keeps its rows."""

from __future__ import annotations

import signal
import threading
from types import SimpleNamespace

import pytest
from distributed import Client

from carosac_toolkit.studies import LostScheduler, read_rows, run_cases
from carosac_toolkit.studies.run import worker_presence
from carosac_toolkit.studies.run.row_files import part_files
from carosac_toolkit.studies.run.worker_presence import Presence
from tests.studies.functions import some_cases
from tests.studies.processes import cluster, wait_until

SCORE = "tests.studies.functions:score"
CASES = some_cases(40, duration=0.05)


@pytest.fixture(autouse=True)
def impatient(monkeypatch):
    durations = {
        "CLUSTER_PATIENCE_S": 3.0, "NOTICE_AFTER_S": 0.5, "QUERY_INTERVAL_S": 0.2,
        "ANSWER_TIMEOUT_S": 2.0,
    }  # fmt: skip
    for name, seconds in durations.items():
        monkeypatch.setattr(worker_presence, name, seconds)


@pytest.fixture
def once_rows_are_kept(tmp_path):
    """Do something in another thread as soon as there are rows on the disk."""
    threads = []

    def start(action):
        def target():
            wait_until(lambda: len(part_files(tmp_path)) > 0)
            action()

        threads.append(threading.Thread(target=target))
        threads[-1].start()

    yield start
    for thread in threads:
        thread.join(30.0)
        assert not thread.is_alive()


def check_that_it_ends(dask, folder, what, errors):
    with pytest.raises(LostScheduler, match=rf"^the scheduler at {dask.address} {what} for \d+ s"):
        run_cases(CASES, SCORE, folder=folder, scheduler=dask.address)
    assert f"study: the scheduler at {dask.address} {what} for" in errors()
    kept = read_rows(folder)
    assert 0 < len(kept) < len(CASES)
    rows = run_cases(CASES, SCORE, folder=folder, workers=2, progress=False)
    assert {row["status"] for row in rows} == {"ok"} and len(rows) == len(CASES)
    assert [row for row in rows if row in kept] == kept


def test_without_workers_a_study_ends(tmp_path, once_rows_are_kept, capsys):
    with cluster() as dask:
        once_rows_are_kept(dask.workers.kill)
        check_that_it_ends(dask, tmp_path, "has had no workers", lambda: capsys.readouterr().err)


def test_a_row_that_died_with_the_last_worker_is_not_waited_for(tmp_path, monkeypatch, capsys):
    gather = Client.gather

    def too_late(client, *args, **options):
        if part_files(tmp_path) and dask.workers.poll() is None:
            dask.workers.kill()
            dask.workers.wait(20.0)
            wait_until(lambda: not client.nthreads())
        return gather(client, *args, **options)

    with cluster() as dask:
        monkeypatch.setattr(Client, "gather", too_late)
        check_that_it_ends(dask, tmp_path, "has had no workers", lambda: capsys.readouterr().err)


def test_a_scheduler_that_is_stuck_ends_the_study(tmp_path, once_rows_are_kept, capsys):
    with cluster() as dask:
        once_rows_are_kept(lambda: dask.scheduler.send_signal(signal.SIGSTOP))
        try:
            check_that_it_ends(dask, tmp_path, "has not answered", lambda: capsys.readouterr().err)
        finally:
            dask.scheduler.send_signal(signal.SIGCONT)


def test_workers_that_come_back_in_time_are_said_to_be_there(monkeypatch):
    monkeypatch.setattr(worker_presence, "NOTICE_AFTER_S", 0.0)
    monkeypatch.setattr(worker_presence, "QUERY_INTERVAL_S", 0.0)
    present: dict[str, int] = {}
    said: list[str] = []
    client = SimpleNamespace(
        status="running", scheduler=SimpleNamespace(address="x"), nthreads=lambda **_: present
    )
    watch = Presence(client, said.append)
    for workers in ({}, {}, {"w": 1}, {"w": 1}, {}):
        present = workers
        watch.check()
    assert [line.partition(" for ")[0] for line in said] == [
        "study: the scheduler at x has had no workers",
        "study: the scheduler at x is there again, with workers",
        "study: the scheduler at x has had no workers",
    ]


def test_a_connection_that_does_not_come_back_ends_the_study(monkeypatch):
    client = SimpleNamespace(status="connecting", scheduler=SimpleNamespace(address="x"))
    watch = Presence(client, print)
    watch.check()
    monkeypatch.setattr(worker_presence, "LOST_AFTER_S", 0.0)
    with pytest.raises(LostScheduler, match="the connection to the scheduler at x is lost"):
        watch.check()
