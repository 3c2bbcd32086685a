"""Set-up of a local worker process before its first case; dask calls `dask_setup` by name.

A worker must not outlive the process that started it, not even when that one is killed and the
worker is stuck in compiled code. Ctrl-C is for the process that started it: the terminal sends it
to the workers too, and there it is ignored.
"""

from __future__ import annotations

import ctypes
import signal
import sys
from typing import Any

PARENT_DEATH_SIGNAL = 1  # PR_SET_PDEATHSIG of prctl(2)


def dask_setup(worker: Any) -> None:
    """Prepare this process."""
    worker.http_server.stop()  # its pages have no password
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PARENT_DEATH_SIGNAL, signal.SIGKILL, 0, 0, 0)
