"""Start Warp silently, compile kernels once, and tell the user when that takes a while."""

from __future__ import annotations

import os
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType

import warp as wp

NOTICE_DELAY_S = 1.0  # [s] of loading before the user is told
COMPILED_VARIABLE = "CAROSAC_COMPILED"  # environment: devices for which a parent has compiled all

_one_at_a_time = threading.RLock()  # Warp's log level is that of the whole process
_loaded: set[tuple[str, str]] = set()
_started: list[bool] = []
_told: set[str] = set()


@contextmanager
def _quiet() -> Iterator[None]:
    """Hold back Warp's banner and its compile log: they go to standard output."""
    with _one_at_a_time:
        level, wp.config.log_level = wp.config.log_level, wp.LOG_WARNING
        try:
            yield
        finally:
            wp.config.log_level = level


@contextmanager
def _without_driver_warning() -> Iterator[None]:
    """Suppress the native start-up message on a missing GPU driver; pass on the rest."""
    sys.stderr.flush()
    kept = os.dup(2)
    with tempfile.TemporaryFile() as caught:
        os.dup2(caught.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(kept, 2)
            os.close(kept)
            caught.seek(0)
            for line in caught:
                if b"CUDA driver" not in line:
                    os.write(2, line)


def initialise() -> None:
    """Start Warp; harmless when it runs already."""
    if _started:
        return
    with _quiet(), _without_driver_warning():
        wp.init()
    _started.append(True)


def load(module: ModuleType, device: str = "cpu") -> None:
    """Compile the kernels of a module, or fetch them from Warp's cache.

    The first use on a machine compiles; one line on standard error says so, for all modules of
    a process. Later uses take milliseconds. The cache is Warp's own (``WARP_CACHE_PATH`` moves it).

    Args:
        module: A Python module that defines Warp kernels.
        device: Warp device name.
    """
    if (module.__name__, device) in _loaded:
        return
    initialise()
    notice = threading.Timer(NOTICE_DELAY_S, _tell, [device])
    notice.daemon = True
    notice.start()
    try:
        with _quiet():
            wp.load_module(module, device=device)
    finally:
        notice.cancel()
    _loaded.add((module.__name__, device))


def silence_children(device: str) -> None:
    """Let processes started from here on load kernels for a device without telling the user.

    For use once all kernels are compiled: a busy machine takes long enough even to fetch them.
    """
    known = os.environ.get(COMPILED_VARIABLE, "").split()
    os.environ[COMPILED_VARIABLE] = " ".join(dict.fromkeys([*known, device]))


def _tell(device: str) -> None:
    """Tell the user, once, why nothing seems to happen."""
    if device not in _told and device not in os.environ.get(COMPILED_VARIABLE, "").split():
        _told.add(device)
        print(
            f"Compiling kernels of statics, dynamics and simulator for {device}, once on this "
            "machine: about half a minute ...",
            file=sys.stderr, flush=True,
        )  # fmt: skip
