"""Priority in Linux's scheduler goes to whom it was meant for."""

import os
import threading

import pytest

from carosac_toolkit.live.real_time import take_priority


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
