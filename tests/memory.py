"""Memory that a call takes, in a process of its own."""

from __future__ import annotations

import multiprocessing
import resource
from collections.abc import Callable
from pathlib import Path

from carosac_toolkit.base.errors import CarosacError


def peak_of(read: Callable[[Path], object], path: Path) -> float:
    """Return how much more memory is taken at the peak of reading a file [bytes]."""
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        return pool.apply(_peak, (read, path))


def _peak(read: Callable[[Path], object], path: Path) -> float:
    import pyarrow.csv
    import pyarrow.parquet  # noqa: F401  imported before, so that it does not count

    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    try:
        read(path)
    except CarosacError:
        pass
    return 1024.0 * (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
