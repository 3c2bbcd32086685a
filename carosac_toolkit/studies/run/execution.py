"""Execution of cases to rows, whatever they do; workers are asked for this."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

from carosac_toolkit.base.errors import CarosacError, InvalidField
from carosac_toolkit.base.version import __version__
from carosac_toolkit.studies.run.case import Case
from carosac_toolkit.studies.run.crash_notes import Death, noted, read_death
from carosac_toolkit.studies.run.rows import Row, checked_values, make_row, row_of_run
from carosac_toolkit.studies.run.time_limit import CaseTimeout, TimeLimit

STOP_GRACE_S = (
    5.0  # [s] a case has to stop by itself when its time is up, if its limit is no shorter
)

CaseFunction = Callable[..., Any]  # of a case, or of several at once


class UnfitWorker(CarosacError):
    """Error of a worker that would give other numbers than the rest."""


@dataclass(frozen=True, kw_only=True)
class WorkerTask:
    """Work for a worker: a case, or several that run together.

    Attributes:
        cases: The fields of each case.
        identities: Their identities by the sender's reckoning.
        function: The case function, as ``module:name``.
        together: The function that runs several, as ``module:name``.
        timeout: Time limit of each case [s].
        attempts: Number of times that the process of one case may die.
        notes: Folder of the notes, on a file system that sender and worker may or may not share.
        own_folder: Folder for the function's own files, which it takes as its second argument;
            empty: it takes none.
    """

    cases: tuple[dict[str, Any], ...]
    identities: tuple[str, ...]
    function: str
    together: str
    timeout: float
    attempts: int
    notes: str
    own_folder: str = ""

    @property
    def identity(self) -> str:
        """Identity of the case; of several, that of the first with their number."""
        count = len(self.cases)
        return self.identities[0] + (f"-and-{count - 1}" if count > 1 else "")

    def alone(self) -> list[WorkerTask]:
        """Return a task for each case."""
        return [
            replace(self, cases=(case,), identities=(identity,))
            for case, identity in zip(self.cases, self.identities, strict=True)
        ]


@dataclass(frozen=True, kw_only=True)
class WorkerAnswer:
    """Answer of a worker.

    Attributes:
        identity: Identity of the task.
        rows: A row for each case; none where several could not run together.
    """

    identity: str
    rows: list[Row]


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


def run_attempt(case: Case, task: WorkerTask) -> Row:
    """Run a case of a task in this thread.

    Returns:
        Its row. Whatever the case raises becomes a row with the reason; only what is meant for the
        whole process, such as Ctrl-C, goes through.

    Raises:
        UnfitWorker: The function cannot be imported here.
    """
    case_function = _found_here(task.function)
    start = time.perf_counter()
    try:
        with TimeLimit(task.timeout):
            values = checked_values(case_function(case, *_own_folder(task)))
        return row_of_run(case, values, wall_time=time.perf_counter() - start)
    except CaseTimeout:
        reason = f"stopped after {task.timeout:g} s"
        return make_row(case, "timed_out", reason=reason, wall_time=time.perf_counter() - start)
    except (Exception, SystemExit) as error:  # a study outlives any case; the reason is in the row
        reason = f"{type(error).__name__}: {error}"
        return make_row(case, "failed", reason=reason, wall_time=time.perf_counter() - start)


def run_attempt_together(cases: Sequence[Case], function: str, timeout: float) -> list[Row]:
    """Run several cases in this thread; `timeout` is for all of them [s].

    Returns:
        A row for each, or none at all where any of them failed: each has to run alone then.

    Raises:
        UnfitWorker: The function cannot be imported here.
    """
    batch_function = _found_here(function)
    start = time.perf_counter()
    try:
        with TimeLimit(timeout):
            values = [checked_values(row) for row in batch_function(cases)]
        wall_time = (time.perf_counter() - start) / len(cases)
        return [
            row_of_run(case, row, wall_time=wall_time)
            for case, row in zip(cases, values, strict=True)
        ]
    except (Exception, SystemExit, CaseTimeout):  # alone, the one to blame says what it was
        return []


def rows_of(task: WorkerTask) -> list[Row]:
    """Run a task in this process, which shares the fate of its cases."""
    cases = [Case.from_dict(fields) for fields in task.cases]
    rows = []
    if len(cases) > 1:
        rows = run_attempt_together(cases, task.together, task.timeout * len(cases))
    return rows or [run_attempt(case, task) for case in cases]


def run_task(task: WorkerTask) -> WorkerAnswer:
    """Run a task in a worker process that it has for itself.

    Raises:
        UnfitWorker: The worker has another version of the toolkit, or runs several tasks at once.
    """
    cases = [Case.from_dict(fields) for fields in task.cases]
    _check_worker(cases, task)
    rows = _batch_of_task(cases, task) if len(cases) > 1 else [_row_of_task(cases[0], task)]
    return WorkerAnswer(identity=task.identity, rows=rows)


def _row_of_task(case: Case, task: WorkerTask) -> Row:
    """Run a case, unless it has cost too many processes."""
    if not Path(task.notes).is_dir():  # a file system of its own: the scheduler counts deaths
        return run_attempt(case, task)
    note = Path(task.notes) / task.identity
    death = read_death(note)
    if death is not None and (death.timed_out or death.attempts >= task.attempts):
        note.unlink(missing_ok=True)
        return _row_of_death(case, death, task.timeout)
    with noted(note, task.timeout + min(STOP_GRACE_S, task.timeout)):
        return run_attempt(case, task)


def _batch_of_task(cases: Sequence[Case], task: WorkerTask) -> list[Row]:
    """Run cases together, unless that has cost a process already."""
    timeout = task.timeout * len(cases)
    if not Path(task.notes).is_dir():
        return run_attempt_together(cases, task.together, timeout)
    note = Path(task.notes) / task.identity
    if read_death(note) is not None:
        note.unlink(missing_ok=True)
        return []
    with noted(note, timeout + min(STOP_GRACE_S, timeout)):
        return run_attempt_together(cases, task.together, timeout)


def crashed_row(case: Case, deaths: int, cause: str = "", wall_time: float = 0.0) -> Row:
    """Return the row of a case whose process died each time."""
    times = f"{deaths} time" + ("s" if deaths != 1 else "")
    cause = cause or "without a message: killed, out of memory, or left by os._exit"
    reason = f"its process died {times}: {cause}"
    return make_row(case, "crashed", reason=reason, wall_time=wall_time)


def _own_folder(task: WorkerTask) -> tuple[Path, ...]:
    """Return the folder for the function, if it takes one, as this machine has it."""
    if not task.own_folder:
        return ()
    folder = Path(task.own_folder)
    if not folder.is_dir():
        raise CarosacError(f"{folder} is not on this machine; workers must share it")
    return (folder,)


@cache
def _found_here(function: str) -> CaseFunction:
    """Import a case function that the sender could import."""
    try:
        return find_function(function)
    except InvalidField as error:
        raise UnfitWorker(f"a worker cannot import what the study runs: {error}") from None


def _row_of_death(case: Case, death: Death, timeout: float) -> Row:
    """Return the row of a case that will not be tried again."""
    if not death.timed_out:
        return crashed_row(case, death.attempts, death.cause, death.wall_time)
    where = death.cause.partition(" in ")[2]
    reason = f"did not stop after {timeout:g} s; its process was ended" + (
        f" in {where}" if where else ""
    )
    return make_row(case, "timed_out", reason=reason, wall_time=death.wall_time)


def _check_worker(cases: Sequence[Case], task: WorkerTask) -> None:
    """Refuse a worker that differs from the sender."""
    from distributed import get_worker

    worker = get_worker()
    if tuple(case.identity for case in cases) != task.identities:
        raise UnfitWorker(
            f"worker {worker.address} has carosac-toolkit {__version__}, unlike the study; "
            "install the same version on all machines"
        )
    if worker.state.nthreads != 1:
        raise UnfitWorker(
            f"worker {worker.address} runs {worker.state.nthreads} cases at once in one process; "
            "start workers with --nthreads 1, and more of them (--nworkers)"
        )
