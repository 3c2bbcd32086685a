"""Thread switching and priority of a process in real time."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator

THREAD_SWITCH_INTERVAL_S = 5e-4  # by default 5e-3
FIFO_PRIORITY = 5  # 1 to 99


@contextlib.contextmanager
def quick_threads() -> Iterator[None]:
    """Let threads take turns quickly, so that an answer does not wait while another computes."""
    usual = sys.getswitchinterval()
    sys.setswitchinterval(THREAD_SWITCH_INTERVAL_S)
    try:
        yield
    finally:
        sys.setswitchinterval(usual)


def take_priority(command: str, *, inherited: bool = True) -> None:
    """Have the scheduler of Linux put this thread before all others; say where it will not.

    Args:
        command: Name of the command for the message, such as ``carosac plc``.
        inherited: Whether the threads and processes that this one starts from now on have it too.
    """
    try:
        policy = os.SCHED_FIFO | (0 if inherited else os.SCHED_RESET_ON_FORK)
        os.sched_setscheduler(0, policy, os.sched_param(FIFO_PRIORITY))
    except (AttributeError, OSError) as error:
        print(f"{command}: warning: no priority: {error}", file=sys.stderr)
