"""What a process in real time asks of Python and of the operating system."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator

SWITCH = 5e-4  # [s] after which a thread lets the others run; usually 5e-3
PRIORITY = 5  # of SCHED_FIFO, 1 to 99


@contextlib.contextmanager
def quick_threads() -> Iterator[None]:
    """Let threads take turns quickly, so that an answer does not wait while another computes."""
    usual = sys.getswitchinterval()
    sys.setswitchinterval(SWITCH)
    try:
        yield
    finally:
        sys.setswitchinterval(usual)


def take_priority(command: str) -> None:
    """Have the scheduler of Linux put this process before all others; say where it will not.

    Threads inherit it: call this before any is started.

    Args:
        command: That says so, such as ``carosac plc``.
    """
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    except (AttributeError, OSError) as error:
        print(f"{command}: warning: no priority: {error}", file=sys.stderr)
