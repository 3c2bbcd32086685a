"""Start Warp silently, compile kernels once, and tell the user when that takes a while."""

from __future__ import annotations

import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType

import warp as wp

NOTICE_AFTER = 1.0  # [s] of loading before the user is told

_loaded: set[tuple[str, str]] = set()


@contextmanager
def _quiet() -> Iterator[None]:
    """Hold back Warp's banner and its compile log: they go to standard output."""
    level, wp.config.log_level = wp.config.log_level, wp.LOG_WARNING
    try:
        yield
    finally:
        wp.config.log_level = level


def initialise() -> None:
    """Start Warp; harmless when it runs already."""
    with _quiet():
        wp.init()


def load(module: ModuleType, device: str = "cpu") -> None:
    """Compile the kernels of a module, or fetch them from Warp's cache.

    The first use on a machine compiles; a line on standard error says so. Later uses take
    milliseconds. The cache is Warp's own (``WARP_CACHE_PATH`` moves it).

    Args:
        module: A Python module that defines Warp kernels.
        device: Warp device name.
    """
    if (module.__name__, device) in _loaded:
        return
    initialise()
    text = f"Compiling {module.__name__} for {device}, once; later runs use the cache ..."
    notice = threading.Timer(NOTICE_AFTER, print, [text], {"file": sys.stderr, "flush": True})
    notice.daemon = True
    notice.start()
    try:
        with _quiet():
            wp.load_module(module, device=device)
    finally:
        notice.cancel()
    _loaded.add((module.__name__, device))
