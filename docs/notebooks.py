"""Run the notebooks: for the tests, and for the documentation, which shows their outputs.

``python docs/notebooks.py`` runs them all and prints how long each took. The notebooks under
version control have no outputs. The documentation is built from executed copies in a cache
(`CACHE`). Where ``CAROSAC_ARTIFACTS`` names a folder, the tests leave the notebooks that they
executed there, and the cache is filled with these. Elsewhere a notebook runs now, once until its
code changes.
"""

from __future__ import annotations

import logging
import os
import re
import sys
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import nbformat

HERE = Path(__file__).resolve().parent
NOTEBOOKS = sorted((HERE / "notebooks").glob("*.ipynb"))
CACHE = HERE / "_build" / "notebooks"
CELL_TIME_MAX_S = 120  # that one cell may take on a slow computer
LOGGER = logging.getLogger("notebooks")
LOGGER.setLevel(logging.WARNING)
COLOR = re.compile(r"\x1b\[[0-9;]*m")  # of IPython's tracebacks


class NotebookFailed(Exception):
    """A cell raised an error or took too long."""


def execute(path: Path) -> Any:
    """Execute a notebook in an empty folder, in a kernel of this interpreter.

    Args:
        path: A notebook; it is not changed.

    Returns:
        A copy with outputs.

    Raises:
        NotebookFailed: A cell raised an error or took longer than `CELL_TIME_MAX_S`.
    """
    from jupyter_client.kernelspec import KernelSpecManager
    from jupyter_client.manager import AsyncKernelManager
    from nbclient import NotebookClient
    from nbclient.exceptions import CellExecutionError, CellTimeoutError

    notebook = nbformat.read(path, as_version=4)
    # Without folders to look in, the kernel is that of this interpreter, whatever is installed.
    kernels = KernelSpecManager(kernel_dirs=[])
    with tempfile.TemporaryDirectory() as folder, tempfile.TemporaryDirectory() as sockets:
        manager = AsyncKernelManager(
            kernel_spec_manager=kernels, transport="ipc", ip=f"{sockets}/kernel"
        )
        client = NotebookClient(
            notebook, km=manager, timeout=CELL_TIME_MAX_S, log=LOGGER,
            record_timing=False, coalesce_streams=True, resources={"metadata": {"path": folder}},
        )  # fmt: skip
        try:
            client.execute(env=kernel_environment(os.environ), cleanup_kc=True)
        except (CellExecutionError, CellTimeoutError, RuntimeError) as error:  # the last: no kernel
            raise NotebookFailed(f"{path.name}: {COLOR.sub('', str(error))}") from error
    return notebook


def kernel_environment(environment: Mapping[str, str]) -> dict[str, str]:
    """Return an environment in which pictures are shown inline."""
    return {name: value for name, value in environment.items() if name != "MPLBACKEND"}


def make() -> None:
    """Fill the cache with executed copies of all notebooks."""
    from jupyter_cache import get_cache
    from jupyter_cache.base import CacheBundleIn

    CACHE.parent.mkdir(exist_ok=True)
    cache = get_cache(CACHE)
    for path in NOTEBOOKS:
        left = Path(os.environ.get("CAROSAC_ARTIFACTS", HERE)) / path.name
        executed = nbformat.read(left, as_version=4) if left.exists() else None
        if executed is None or codes(executed) != codes(nbformat.read(path, as_version=4)):
            if is_cached(cache, path):
                continue
            print(f"notebooks: {path.name} runs ...", flush=True)
            executed = execute(path)
        bundle = CacheBundleIn(executed, str(path))
        cache.cache_notebook_bundle(bundle, check_validity=False, overwrite=True)


def is_cached(cache: Any, path: Path) -> bool:
    """Return True if the cache has an executed copy with the same code."""
    try:
        cache.match_cache_notebook(nbformat.read(path, as_version=4))
    except KeyError:
        return False
    return True


def codes(notebook: Any) -> list[str]:
    """Return the code cells of a notebook."""
    return [cell.source for cell in notebook.cells if cell.cell_type == "code"]


def main() -> None:
    """Run them all; the first that fails ends the program."""
    for path in NOTEBOOKS:
        start = time.perf_counter()
        execute(path)
        print(f"{path.name}: {time.perf_counter() - start:.0f} s", flush=True)


if __name__ == "__main__":
    try:
        main()
    except NotebookFailed as error:
        sys.exit(str(error))
