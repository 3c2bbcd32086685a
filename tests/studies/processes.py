"""Start studies in processes of their own, watch them and end them."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import psutil
from distributed import Client

ROOT = Path(__file__).resolve().parents[2]
STARTED = 60.0  # [s] a dask process is waited for
SCRIPT = """
import signal
signal.signal(signal.SIGINT, signal.default_int_handler)  # what a shell starts with & ignores it
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


@dataclass(frozen=True)
class Cluster:
    """A dask scheduler and its workers in other processes.

    Attributes:
        address: Address of the scheduler.
        scheduler: Its process.
        workers: The process that starts the workers, and starts them again.
    """

    address: str
    scheduler: subprocess.Popen
    workers: subprocess.Popen


@contextmanager
def cluster(*, workers: int = 1, threads: int = 1) -> Iterator[Cluster]:
    """Run a dask scheduler and workers; print what they said if the block raises."""
    with TemporaryDirectory() as folder, ExitStack() as stack:
        log = Path(folder) / "log"
        counts = ("--nworkers", str(workers), "--nthreads", str(threads))
        try:
            main = _dask(stack, log, "scheduler", "--port", "0", "--idle-timeout", "600")
            wait_until(lambda: bool(_address(log)), STARTED)
            hands = _dask(stack, log, "worker", _address(log), *counts, "--death-timeout", "60")
            _await_workers(_address(log), workers)
            yield Cluster(_address(log), main, hands)
        except BaseException:
            print(log.read_text())
            raise


def _dask(stack: ExitStack, log: Path, *words: str) -> subprocess.Popen:
    """Start a dask process that ends with the stack."""
    with log.open("a") as file:
        process = subprocess.Popen(
            [sys.executable, "-m", "dask", *words, "--host", "127.0.0.1", "--no-dashboard"],
            env=os.environ | {"PYTHONPATH": str(ROOT)},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=file,
        )
    stack.callback(_end, process)
    return process


def _end(process: subprocess.Popen) -> None:
    """End a process, kindly at first."""
    process.terminate()
    try:
        process.wait(20)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait(20)


def _address(log: Path) -> str:
    """Address of the scheduler, as soon as it has said so."""
    found = re.search(r"Scheduler at: +(\S+)\n", log.read_text())
    return found[1] if found else ""


def _await_workers(address: str, count: int) -> None:
    """Wait for workers that will be started again when they die.

    A worker is there a moment before its nanny knows; if it dies in that moment, `dask worker`
    ends as a whole, with status 1.
    """
    with Client(address, timeout=STARTED, set_as_default=False) as client:
        client.wait_for_workers(count, timeout=STARTED)
        wait_until(lambda: set(client.run(_status, nanny=True).values()) == {"running"}, STARTED)


def _status(dask_worker: Any) -> str:
    """Status of the nanny that runs this."""
    return str(dask_worker.status.name)
