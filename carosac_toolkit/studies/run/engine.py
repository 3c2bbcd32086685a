"""Run the cases of a study: in this process, on all cores, or on a cluster."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path

from carosac_toolkit.base.delayed_signals import delayed_signals
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.extras import install_command
from carosac_toolkit.base.tables import counted
from carosac_toolkit.studies.run.batching import Batching
from carosac_toolkit.studies.run.case import Case
from carosac_toolkit.studies.run.cluster import (
    PARALLEL_EXTRA,
    default_workers,
    has_parallel_packages,
    local_client,
    remote_client,
    require_parallel_packages,
)
from carosac_toolkit.studies.run.dispatch import Dispatcher
from carosac_toolkit.studies.run.execution import WorkerTask, find_function, rows_of
from carosac_toolkit.studies.run.folder import (
    StudyFolder,
    check_statuses,
    notes_folder,
    opened,
    read_rows,
)
from carosac_toolkit.studies.run.progress import Progress
from carosac_toolkit.studies.run.rows import Row

SERIAL_CASES_MAX = 4  # cases that are not worth a process of their own
FLUSH_INTERVAL_S = 1.0  # [s] between two files of rows
DEFAULT_TIMEOUT_S = 600.0  # [s]
INTERRUPTED_NOTE = "study: interrupted; the same call runs the rest"
ONE_PROCESS_NOTE = "study: one case after another, on one core; for all cores: "


def run_cases(
    cases: Sequence[Case],
    function: str,
    *,
    folder: str | Path,
    scheduler: str | None = None,
    workers: int | None = None,
    timeout: float = DEFAULT_TIMEOUT_S,
    attempts: int = 3,
    retry: Collection[str] = (),
    again: Collection[str] = (),
    batching: Batching | None = None,
    own_files: bool = False,
    share: Callable[[], float] | None = None,
    begun: Callable[[], object] | None = None,
    progress: bool = True,
) -> list[Row]:
    """Run each case once and return one row per case, in the order of the cases.

    Rows come to disk about every second. A second call with the same folder runs only what is
    missing, whatever ended the first one. A case that raises, hangs or kills its process costs
    itself only: its row says what happened. The rows do not depend on the number of workers, on
    the order in which they finish, or on interruptions. On several processes a first Ctrl-C or
    SIGTERM keeps the finished rows and then ends the call; a second one does not wait.

    Args:
        cases: The cases, all different.
        function: Case function, as ``module:name``: takes a `Case` and returns a flat dict of
            finite numbers, text, true/false and None. It runs in another process in general. A
            text under ``diverged`` says why its numbers are no score.
        folder: Folder for the rows. A folder that holds fewer cases of the same study is extended.
        scheduler: Address of a dask scheduler to use, such as ``tcp://host:8786``. Its workers
            need one thread each (``--nthreads 1``) and the same version of the toolkit.
        workers: Number of worker processes on this machine; 0 runs all cases in this process,
            which shares the fate of a case that dies. By default as many as there are cores, and 0
            for a handful of cases or without the extra ``parallel``.
        timeout: Time limit of a case [s]; a case's own ``settings["timeout"]`` takes precedence.
            It then has 5 s, or once more its time if that is less, before its process is ended.
        attempts: Number of times that a case may kill its process before it is given up.
        retry: Statuses of finished cases to run again: ``"diverged"``, ``"failed"``,
            ``"crashed"``, ``"timed_out"``.
        again: Identities of finished cases to run again, whatever came of them.
        batching: How cases run together; None: each alone. Where one of a batch fails, or its
            process dies, all of it run alone.
        own_files: True if the case function takes the study's folder as a second argument, for
            files of its own. Workers of a scheduler must see the same folder then.
        share: Tells how much of the work is done, 0 to 1, where cases are few and long; without
            it the finished cases tell.
        begun: Called once the folder is ours, before any case runs.
        progress: True to report progress on standard error.

    Raises:
        InvalidField: An argument is not allowed.
        MissingExtra: Workers or a scheduler without the extra ``parallel``.
        StudyConflict: The folder holds another study, or another process uses it.
        LostScheduler: The scheduler went away, or had no workers for 120 s; what was finished is
            in the folder.
        UnfitWorker: A worker of the scheduler would give other numbers.
        InvalidFile: A file in the folder is broken.
    """
    _check(cases, function, scheduler, workers, attempts)
    if own_files and batching is not None:
        raise InvalidField("batching", repr(batching), "None with own_files")
    check_statuses(retry)
    limits = [_limit(case, timeout) for case in cases]
    path = Path(folder)
    with opened(path, cases, function) as store:
        store.merge()
        store.forget(retry)
        store.forget_cases(again)
        if begun is not None:
            begun()
        done = store.finished()
        bar = Progress(len(cases), done.values(), quiet=not progress, share=share)
        todo = [
            (x, limit) for x, limit in zip(cases, limits, strict=True) if x.identity not in done
        ]
        if todo:
            count = _worker_count(workers, len(cases), len(todo))
            with ExitStack() as stack:
                here = scheduler is None and count == 0
                # In a callback of a weak reference Python drops KeyboardInterrupt; dask has many
                ended = _never if here else stack.enter_context(delayed_signals())
                if here and len(todo) > SERIAL_CASES_MAX and not has_parallel_packages():
                    bar.say(ONE_PROCESS_NOTE + install_command([PARALLEL_EXTRA]))
                notes = "" if here else stack.enter_context(notes_folder(path))
                own = str(path.resolve()) if own_files else ""
                tasks = _tasks(todo, function, attempts, notes, own, batching)
                batches: Iterable[list[Row]] = (
                    map(rows_of, tasks)
                    if here
                    else _on_workers(stack, tasks, scheduler, count, bar.say)
                )
                _keep(batches, store, bar, ended)
            store.merge()
    return read_rows(path)


def _tasks(
    todo: Sequence[tuple[Case, float]],
    function: str,
    attempts: int,
    notes: str,
    own_folder: str,
    batching: Batching | None,
) -> list[WorkerTask]:
    """Return the tasks for the workers."""
    parts = batching.parts([case for case, _ in todo]) if batching else [[x] for x, _ in todo]
    limits = {case.identity: limit for case, limit in todo}
    return [
        WorkerTask(
            cases=tuple(case.to_dict() for case in part),
            identities=tuple(case.identity for case in part),
            function=function,
            together=batching.function if batching else "",
            timeout=limits[part[0].identity],
            attempts=attempts,
            notes=notes,
            own_folder=own_folder,
        )
        for part in parts
    ]


def _on_workers(
    stack: ExitStack,
    tasks: Sequence[WorkerTask],
    scheduler: str | None,
    count: int,
    say: Callable[[str], None],
) -> Iterator[list[Row]]:
    """Run cases on workers that live as long as the stack."""
    client = stack.enter_context(remote_client(scheduler) if scheduler else local_client(count))
    return Dispatcher(client, tasks, say).batches()


def _never() -> bool:
    """Say that no signal waits."""
    return False


def _keep(
    batches: Iterable[list[Row]], store: StudyFolder, bar: Progress, ended: Callable[[], bool]
) -> None:
    """Write rows to the disk as they come, and those at hand whatever happens.

    Args:
        batches: The rows.
        store: Where to.
        bar: Shows how many there are.
        ended: Says whether to leave.
    """
    pending: list[Row] = []
    flushed = time.monotonic()
    try:
        for rows in batches:
            pending += rows
            bar.add(rows)
            if time.monotonic() - flushed >= FLUSH_INTERVAL_S:
                ready, pending = pending, []  # never twice: an interrupted write is not repeated
                store.append(ready)
                flushed = time.monotonic()
            if ended():
                bar.say(INTERRUPTED_NOTE)
                break
    except KeyboardInterrupt:
        bar.say(INTERRUPTED_NOTE)
        raise
    finally:
        store.append(pending)
        bar.close()


def _check(
    cases: Sequence[Case],
    function: str,
    scheduler: str | None,
    workers: int | None,
    attempts: int,
) -> None:
    """Refuse arguments before any work is done."""
    find_function(function)
    seen: dict[str, int] = {}
    for i, case in enumerate(cases):
        if case.identity in seen:
            raise InvalidField(f"cases[{i}]", f"the same as cases[{seen[case.identity]}]", "others")
        seen[case.identity] = i
    if not cases:
        raise InvalidField("cases", "none", "one or more")
    if workers is not None and (workers < 0 or scheduler is not None):
        allowed = "no number of workers with a scheduler" if scheduler else "0 or more"
        raise InvalidField("workers", str(workers), allowed)
    if workers:
        processes = counted(workers, "worker process", "worker processes")
        require_parallel_packages(f"a run on {processes}")
    if attempts < 1:
        raise InvalidField("attempts", str(attempts), "1 or more")


def _limit(case: Case, timeout: float) -> float:
    """Return the time limit of a case [s]."""
    limit = case.settings.get("timeout", timeout)
    if isinstance(limit, bool) or not isinstance(limit, (int, float)) or not 0.0 < limit < 1e7:
        raise InvalidField("timeout", f"{limit!r} s", "0 < timeout < 1e7 s")
    return float(limit)


def _worker_count(workers: int | None, asked: int, left: int) -> int:
    """Return the number of local workers; few cases are counted over the whole study."""
    if workers is not None:
        return min(workers, left)
    return 0 if asked <= SERIAL_CASES_MAX else min(default_workers(), left)
