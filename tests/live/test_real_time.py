"""Priority in Linux's scheduler goes to whom it was meant for."""

import ctypes
import gc
import os
import threading
from concurrent.futures import ThreadPoolExecutor

import pytest

from carosac_toolkit.live import real_time as real_time_module
from carosac_toolkit.live.real_time import (
    RealTime,
    isolated_cores,
    short_pauses,
    take_priority,
)


def policies(*, inherited: bool) -> tuple[int, int]:
    """Of a thread that takes priority, and of one that it starts afterwards."""
    found = []

    def note() -> None:
        found.append(os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK)

    def first() -> None:
        take_priority("test", inherited=inherited)
        note()
        second = threading.Thread(target=note)
        second.start()
        second.join()

    thread = threading.Thread(target=first)
    thread.start()
    thread.join()
    return found[0], found[1]


@pytest.mark.parametrize("inherited", [False, True])
def test_threads_started_later_have_priority_only_where_asked(inherited, capsys):
    own, later = policies(inherited=inherited)
    if "no priority" in capsys.readouterr().err:
        assert own == later == os.SCHED_OTHER
        pytest.skip("this user has no right to real-time priority")
    assert own == os.SCHED_FIFO
    assert (later == os.SCHED_FIFO) == inherited


@pytest.fixture
def isolated(tmp_path, monkeypatch):
    """Has Linux say that the last core of this process is isolated."""
    cores = sorted(os.sched_getaffinity(0))
    path = tmp_path / "isolated"
    path.write_text(f"{cores[-1]}-{cores[-1] + 2},{cores[-1] + 9}\n")
    monkeypatch.setattr(real_time_module, "ISOLATED_CORES", path)
    return cores


def test_isolated_cores_are_read_as_linux_writes_them(isolated):
    last = isolated[-1]
    assert isolated_cores() == {last, last + 1, last + 2, last + 9}


def test_a_loop_in_real_time_keeps_a_core_and_collects_garbage_at_rest_only(isolated, capsys):
    cores, resting = os.sched_getaffinity(0), False
    found = []

    class Waste:
        def __init__(self):
            self.itself = self

        def __del__(self):
            found.append("collected")

    def loop() -> None:
        nonlocal resting
        with RealTime("test", lambda: resting) as real_time:
            Waste()
            real_time.cycle()
            assert not found and not gc.isenabled()
            assert os.sched_getaffinity(0) == ({max(cores)} if len(cores) > 1 else cores)
            resting = True
            real_time.cycle()
            assert found
        assert os.sched_getaffinity(0) == cores and gc.isenabled()

    with ThreadPoolExecutor(1) as pool:
        pool.submit(loop).result()
    assert found == ["collected"]
    words = capsys.readouterr().err
    assert all(line.startswith("test: warning: no ") for line in words.splitlines())


def test_a_core_that_is_not_isolated_is_left_to_all(capsys, monkeypatch, tmp_path):
    monkeypatch.setattr(real_time_module, "ISOLATED_CORES", tmp_path / "none")
    cores = os.sched_getaffinity(0)

    def loop() -> None:
        with RealTime("test", lambda: False) as real_time:
            real_time.cycle()
            assert os.sched_getaffinity(0) == cores

    with ThreadPoolExecutor(1) as pool:
        pool.submit(loop).result()
    assert "test: warning: no core: none of" in capsys.readouterr().err


def test_what_cannot_be_had_is_named(isolated, capsys, monkeypatch):
    def refuse(*_, **__):
        raise PermissionError(1, "Operation not permitted")

    for name in ("sched_setscheduler", "sched_setaffinity"):
        monkeypatch.setattr(os, name, refuse)
    monkeypatch.setattr(ctypes, "CDLL", refuse)
    with RealTime("test", lambda: False) as real_time:
        real_time.cycle()
    words = capsys.readouterr().err
    for what in ("priority", "memory lock", "core"):
        assert f"test: warning: no {what}: [Errno 1] Operation not permitted" in words


def test_priority_is_given_back(capsys, monkeypatch):
    """The policy of this thread, which may be that of a notebook, is what it was."""
    policies = [(os.SCHED_BATCH, os.sched_param(0))]
    monkeypatch.setattr(os, "sched_getscheduler", lambda _: policies[-1][0])
    monkeypatch.setattr(os, "sched_getparam", lambda _: policies[-1][1])
    monkeypatch.setattr(os, "sched_setscheduler", lambda _, *policy: policies.append(policy))
    with RealTime("test", lambda: False):
        assert policies[-1][0] == os.SCHED_FIFO
    assert policies[-1] is not policies[0] and policies[-1] == policies[0]


def test_a_collection_of_garbage_spares_what_was_there_before():
    old = [[] for _ in range(1000)]
    with short_pauses():
        new = [[] for _ in range(1000)]
        looked_at = {id(thing) for thing in gc.get_objects()}
        assert not looked_at & {id(thing) for thing in old}
        assert looked_at >= {id(thing) for thing in new}
