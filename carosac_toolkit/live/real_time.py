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


def take_priority(command: str, *, inherited: bool = True) -> None:
    """Have the scheduler of Linux put this thread before all others; say where it will not.

    Args:
        command: That says so, such as ``carosac plc``.
        inherited: Whether the threads and processes that this one starts from now on have it too.
    """
    try:
        policy = os.SCHED_FIFO | (0 if inherited else os.SCHED_RESET_ON_FORK)
        os.sched_setscheduler(0, policy, os.sched_param(PRIORITY))
    except (AttributeError, OSError) as error:
        print(f"{command}: warning: no priority: {error}", file=sys.stderr)
