"""Start studies in processes of their own, watch them and end them."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import psutil

ROOT = Path(__file__).resolve().parents[2]
SCRIPT = """
import sys
from carosac_toolkit.studies import run_cases
from tests.studies.functions import one_case, some_cases
print("the script runs", flush=True)
run_cases({cases}, "tests.studies.functions:{function}", folder={folder!r}, {options})
"""


def start(folder: Path, cases: str, function: str, options: str = "workers=2") -> subprocess.Popen:
    """Run a study from a script that is not guarded against being imported."""
    script = folder.parent / f"{folder.name}_script.py"
    script.write_text(
        SCRIPT.format(cases=cases, function=function, folder=str(folder), options=options)
    )
    return subprocess.Popen(
        [sys.executable, str(script)],
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def wait_until(condition: Callable[[], bool], seconds: float = 20.0) -> None:
    """Wait for something to happen."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it did not happen"
        time.sleep(0.02)


def descendants(process: subprocess.Popen) -> list[psutil.Process]:
    """Processes that a process has started, directly or not."""
    return psutil.Process(process.pid).children(recursive=True)


def workers_of(process: subprocess.Popen) -> list[psutil.Process]:
    """Worker processes of a study."""
    return [x for x in descendants(process) if "spawn_main" in " ".join(x.cmdline())]


def alive(processes: list[psutil.Process]) -> list[psutil.Process]:
    """Those that still run."""
    return [x for x in processes if x.is_running() and x.status() != psutil.STATUS_ZOMBIE]


@contextmanager
def scheduler(*worker_options: str) -> Iterator[str]:
    """Run a dask scheduler and its workers in other processes; give its address."""
    dask = [sys.executable, "-m", "dask"]
    quiet = {"env": os.environ | {"PYTHONPATH": str(ROOT)}, "stderr": subprocess.PIPE, "text": True}
    host = ("--host", "127.0.0.1", "--no-dashboard")
    main = subprocess.Popen([*dask, "scheduler", "--port", "0", *host], **quiet)
    workers = None
    try:
        address = next(line.split()[-1] for line in main.stderr if "Scheduler at:" in line)
        workers = subprocess.Popen(
            [*dask, "worker", address, *host, *worker_options],
            **quiet | {"stderr": subprocess.DEVNULL},
        )
        yield address
    finally:
        for process in (workers, main):
            if process is not None:
                process.terminate()
                process.wait(20)
        main.stderr.close()
