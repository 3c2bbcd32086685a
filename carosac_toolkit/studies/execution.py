"""Run one case to its row, whatever the case does; this is what workers are asked for."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

from carosac_toolkit import __version__
from carosac_toolkit.errors import CarosacError, InvalidField
from carosac_toolkit.studies.attempts import Death, noted, read_death
from carosac_toolkit.studies.case import Case
from carosac_toolkit.studies.rows import Row, checked_values, make_row
from carosac_toolkit.studies.time_limit import CaseTimeout, TimeLimit

GRACE = 5.0  # [s] a case has to stop by itself when its time is up, if its limit is no shorter

CaseFunction = Callable[[Case], Any]


class UnfitWorker(CarosacError):
    """A worker that would give other numbers than the rest."""


@dataclass(frozen=True, kw_only=True)
class Task:
    """What a worker is sent.

    Attributes:
        case: The fields of the case.
        identity: Its identity by the sender's reckoning.
        function: The case function, as ``module:name``.
        timeout: How long the case may run [s].
        attempts: How many times its process may die.
        notes: Folder of the notes, on a file system that sender and worker may or may not share.
    """

    case: dict[str, Any]
    identity: str
    function: str
    timeout: float
    attempts: int
    notes: str


def find_function(name: str) -> CaseFunction:
    """Import a case function.

    Args:
        name: ``module:name``.

    Raises:
        InvalidField: It cannot be imported, or not from another process.
    """
    allowed = "module:name of a function that any process can import"
    module, _, attribute = name.partition(":")
    if not attribute or module in ("", "__main__"):
        raise InvalidField("function", repr(name), allowed)
    try:
        function = getattr(import_module(module), attribute)
    except (ImportError, AttributeError) as error:
        raise InvalidField("function", repr(name), f"{allowed} ({error})") from error
    if not callable(function):
        raise InvalidField("function", repr(name), f"{allowed}; this is no function")
    return function  # type: ignore[no-any-return]


def run_attempt(case: Case, function: str, timeout: float) -> Row:
    """Run a case in this thread.

    Returns:
        Its row. Whatever the case raises becomes a row with the reason; only what is meant for the
        whole process, such as Ctrl-C, goes through.

    Raises:
        UnfitWorker: The function cannot be imported here.
    """
    found = _found_here(function)
    start = time.perf_counter()
    try:
        with TimeLimit(timeout):
            values = checked_values(found(case))
        return make_row(case, "ok", values=values, wall_time=time.perf_counter() - start)
    except CaseTimeout:
        reason = f"stopped after {timeout:g} s"
        return make_row(case, "timed_out", reason=reason, wall_time=time.perf_counter() - start)
    except (Exception, SystemExit) as error:  # a study outlives any case; the reason is in the row
        reason = f"{type(error).__name__}: {error}"
        return make_row(case, "failed", reason=reason, wall_time=time.perf_counter() - start)


def run_task(task: Task) -> Row:
    """Run a case in a worker process that it has for itself.

    Raises:
        UnfitWorker: The worker has another version of the toolkit, or runs several cases at once.
    """
    case = Case.from_dict(task.case)
    _check_worker(case, task)
    if not Path(task.notes).is_dir():  # a file system of its own: the scheduler counts deaths
        return run_attempt(case, task.function, task.timeout)
    note = Path(task.notes) / task.identity
    death = read_death(note)
    if death is not None and (death.timed_out or death.attempts >= task.attempts):
        note.unlink(missing_ok=True)
        return _row_of_death(case, death, task.timeout)
    with noted(note, task.timeout + min(GRACE, task.timeout)):
        return run_attempt(case, task.function, task.timeout)


def crashed_row(case: Case, deaths: int, cause: str = "", wall_time: float = 0.0) -> Row:
    """Row of a case whose process died each time."""
    times = f"{deaths} time" + ("s" if deaths != 1 else "")
    cause = cause or "without a word: killed, out of memory, or left by os._exit"
    reason = f"its process died {times}: {cause}"
    return make_row(case, "crashed", reason=reason, wall_time=wall_time)


@cache
def _found_here(function: str) -> CaseFunction:
    """Import a case function that the sender could import."""
    try:
        return find_function(function)
    except InvalidField as error:
        raise UnfitWorker(f"a worker cannot import what the study runs: {error}") from None


def _row_of_death(case: Case, death: Death, timeout: float) -> Row:
    """Row of a case that will not be tried again."""
    if not death.timed_out:
        return crashed_row(case, death.attempts, death.cause, death.wall_time)
    where = death.cause.partition(" in ")[2]
    reason = f"did not stop after {timeout:g} s; its process was ended" + (
        f" in {where}" if where else ""
    )
    return make_row(case, "timed_out", reason=reason, wall_time=death.wall_time)


def _check_worker(case: Case, task: Task) -> None:
    """Refuse a worker that is not like the sender."""
    from distributed import get_worker

    worker = get_worker()
    if case.identity != task.identity:
        raise UnfitWorker(
            f"worker {worker.address} has carosac-toolkit {__version__}, unlike the study; "
            "install the same version on all machines"
        )
    if worker.state.nthreads != 1:
        raise UnfitWorker(
            f"worker {worker.address} runs {worker.state.nthreads} cases at once in one process; "
            "start workers with --nthreads 1, and more of them (--nworkers)"
        )
