"""Thread switching, priority, memory and core of a process in real time."""

from __future__ import annotations

import contextlib
import ctypes
import gc
import os
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import TracebackType

THREAD_SWITCH_INTERVAL_S = 5e-4  # by default 5e-3
FIFO_PRIORITY = 5  # 1 to 99
ISOLATED_CORES = Path("/sys/devices/system/cpu/isolated")
COLLECT_PERIOD_S = 1.0  # between two collections of garbage at rest
MCL_CURRENT, MCL_FUTURE, MCL_ONFAULT = 1, 2, 4  # of mlockall(2)


@contextlib.contextmanager
def short_pauses() -> Iterator[None]:
    """Let threads take turns quickly, and keep collections of garbage short.

    A collection looks at all objects, and the libraries have so many that it takes over 0.1 s.
    Within the block it looks at those alone that were made in it.
    """
    usual = sys.getswitchinterval()
    sys.setswitchinterval(THREAD_SWITCH_INTERVAL_S)
    frozen = gc.get_freeze_count()
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        if not frozen:
            gc.unfreeze()
        sys.setswitchinterval(usual)


def take_priority(command: str, *, inherited: bool = True) -> tuple[int, os.sched_param] | None:
    """Have the scheduler of Linux put this thread before all others; say where it will not.

    Args:
        command: Name of the command for the message, such as ``carosac plc``.
        inherited: Whether the threads and processes that this one starts from now on have it too.

    Returns:
        Policy and parameter of before, or None where it stays.
    """
    try:
        before = os.sched_getscheduler(0), os.sched_getparam(0)
        policy = os.SCHED_FIFO | (0 if inherited else os.SCHED_RESET_ON_FORK)
        os.sched_setscheduler(0, policy, os.sched_param(FIFO_PRIORITY))
    except (AttributeError, OSError) as error:
        print(f"{command}: warning: no priority: {error}", file=sys.stderr)
        return None
    return before


def isolated_cores() -> set[int]:
    """Return the cores on which the scheduler of Linux puts nothing by itself."""
    text = ISOLATED_CORES.read_text().strip() if ISOLATED_CORES.exists() else ""
    spans = [span.partition("-") for span in text.split(",") if span]
    return {k for low, _, high in spans for k in range(int(low), int(high or low) + 1)}


class RealTime:
    """What a loop in real time can have of Linux and Python; what it cannot have is named.

    Within the block: priority before ordinary processes, also for threads started later; memory
    that is used stays in memory; garbage is collected at rest only. From the first `cycle` on its
    thread keeps an isolated core; the other threads, above all the watchdog, keep all cores. On a
    core that is not isolated it would wait for others of its priority while another core is free.
    """

    def __init__(self, command: str, at_rest: Callable[[], bool]) -> None:
        """Set up for a command, such as ``carosac run``; `at_rest`: nothing moves now."""
        self._command, self._at_rest = command, at_rest
        self._cores: set[int] | None = None
        self._locked = False
        self._usual: tuple[int, os.sched_param] | None = None
        self._collected = 0.0

    def __enter__(self) -> RealTime:
        """Take priority, lock memory, and switch the collection of garbage off."""
        self._usual = take_priority(self._command)
        self._locked = self._call("memory lock", "mlockall", MCL_CURRENT | MCL_FUTURE | MCL_ONFAULT)
        gc.collect()
        gc.disable()
        return self

    def cycle(self) -> None:
        """Keep a core from the first cycle on; collect garbage where nothing moves."""
        if self._cores is None:
            self._cores = self._keep_a_core()
        now = time.monotonic()
        if now - self._collected > COLLECT_PERIOD_S and self._at_rest():
            self._collected = now
            gc.collect()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:  # fmt: skip
        """Give back cores, memory and priority, and collect garbage as before."""
        gc.enable()
        if self._locked:
            self._call("memory unlock", "munlockall")
        if self._cores:
            os.sched_setaffinity(0, self._cores)
        if self._usual is not None:
            os.sched_setscheduler(0, *self._usual)

    def _keep_a_core(self) -> set[int]:
        """Move this thread to one core; return those that it had, none where it stays."""
        try:
            cores = os.sched_getaffinity(0)
            isolated = cores & isolated_cores()
            if not isolated or len(cores) < 2:
                raise OSError(f"none of {sorted(cores)} is isolated (isolcpus), with one besides")
            os.sched_setaffinity(0, {max(isolated)})
        except (AttributeError, OSError) as error:
            self._warn("core", error)
            return set()
        return cores

    def _call(self, what: str, function: str, *arguments: int) -> bool:
        """Call a function of the C library that returns 0 on success; return whether it did."""
        try:
            if getattr(ctypes.CDLL(None, use_errno=True), function)(*arguments) != 0:
                number = ctypes.get_errno()
                raise OSError(number, os.strerror(number))
        except (AttributeError, OSError, TypeError) as error:
            self._warn(what, error)
            return False
        return True

    def _warn(self, what: str, error: Exception) -> None:
        """Name what could not be had."""
        print(f"{self._command}: warning: no {what}: {error}", file=sys.stderr)
