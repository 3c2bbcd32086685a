"""Priority in Linux's scheduler goes to whom it was meant for."""

import ctypes
import gc
import os
import threading
from concurrent.futures import ThreadPoolExecutor

import pytest

from carosac_toolkit.live.real_time import RealTime, take_priority


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


def test_a_loop_in_real_time_keeps_a_core_and_collects_garbage_at_rest_only(capsys):
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
            assert len(os.sched_getaffinity(0)) == 1
            resting = True
            real_time.cycle()
            assert found
        assert os.sched_getaffinity(0) == cores and gc.isenabled()

    with ThreadPoolExecutor(1) as pool:
        pool.submit(loop).result()
    assert found == ["collected"]
    words = capsys.readouterr().err
    assert all(line.startswith("test: warning: no ") for line in words.splitlines())


def test_what_cannot_be_had_is_named(capsys, monkeypatch):
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
