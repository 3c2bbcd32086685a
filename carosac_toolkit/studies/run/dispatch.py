"""Dispatch of tasks to workers and collection of their rows as they come."""

from __future__ import annotations

import asyncio
import uuid
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import wait
from queue import Empty, SimpleQueue
from typing import Any

from carosac_toolkit.base.errors import CarosacError
from carosac_toolkit.studies.run.case import Case
from carosac_toolkit.studies.run.execution import WorkerAnswer, WorkerTask, crashed_row, run_task
from carosac_toolkit.studies.run.rows import Row
from carosac_toolkit.studies.run.worker_presence import LOST_AFTER_S, LostScheduler, Presence

POLL_INTERVAL_S = 0.25  # [s] the longest wait without a sign of life
PENDING_TASKS_MIN = 256  # tasks that the scheduler knows at a time, at least
TASKS_PER_THREAD = 16


class Dispatcher:
    """Sender of tasks to a dask scheduler, no more at a time than keep its workers busy.

    Args:
        client: Client of the scheduler.
        tasks: Tasks to run.
        say: Tells the user a line.
    """

    def __init__(
        self, client: Any, tasks: Sequence[WorkerTask], say: Callable[[str], None]
    ) -> None:
        self._client = client
        self._presence = Presence(client, say)
        self._waiting = deque(tasks)
        self._suspects: deque[WorkerTask] = deque()
        self._alone: WorkerTask | None = None
        self._running: dict[str, tuple[Any, WorkerTask]] = {}
        self._done: SimpleQueue[str] = SimpleQueue()
        self._token = uuid.uuid4().hex[:8]
        self._window = max(PENDING_TASKS_MIN, TASKS_PER_THREAD * sum(client.nthreads().values()))

    def batches(self) -> Iterator[list[Row]]:
        """Yield rows until there is one per task; an empty list now and then while none comes.

        Raises:
            LostScheduler: There is nobody left to do the work.
            CarosacError: A worker refuses it.
        """
        self._fill()
        while self._running:
            done = self._wait()
            yield self._collect(done) if done else []
            self._fill()

    def _fill(self) -> None:
        """Send tasks when few are left; send suspects one by one when all others are done."""
        if self._waiting and len(self._running) <= self._window // 2:
            count = min(len(self._waiting), self._window - len(self._running))
            self._send([self._waiting.popleft() for _ in range(count)])
        elif not self._running and self._suspects:
            self._alone = self._suspects.popleft()
            self._send([self._alone])

    def _send(self, tasks: Sequence[WorkerTask]) -> None:
        """Give tasks to the scheduler."""
        turn = "alone" if self._alone else "case"
        keys = [f"{turn}-{self._token}-{task.identity}" for task in tasks]
        futures = self._client.map(run_task, tasks, key=keys, pure=False, retries=0)
        for future, task in zip(futures, tasks, strict=True):
            self._watch(future, task)

    def _watch(self, future: Any, task: WorkerTask) -> None:
        """Register to be told when a task ends."""
        self._running[future.key] = future, task
        future.add_done_callback(lambda future: self._done.put(future.key))

    def _wait(self) -> list[str]:
        """Return the keys of all tasks that have ended; empty after a timeout."""
        keys = []
        try:
            keys.append(self._done.get(timeout=POLL_INTERVAL_S))
            while True:
                keys.append(self._done.get_nowait())
        except Empty:
            pass
        if keys:
            self._presence.confirm()
        else:
            self._presence.check()
        return [key for key in keys if key in self._running]

    def _collect(self, keys: Sequence[str]) -> list[Row]:
        """Take the results of tasks that have ended."""
        ended = [(*self._running.pop(key), key) for key in keys]
        failed = [key for future, _, key in ended if future.status in ("error", "cancelled")]
        good = [future for future, _, key in ended if key not in failed]
        try:
            done = {answer.identity: answer.rows for answer in self._results(good)}
            errors = {
                x.key: x.exception(timeout=LOST_AFTER_S) for x, _, key in ended if key in failed
            }
        except (OSError, TimeoutError) as error:
            raise LostScheduler(
                f"the scheduler does not return its results ({error}); run again to go on"
            ) from error
        rows = [row for answer in done.values() for row in answer]
        for future, task, key in ended:
            if key in errors:
                rows += self._judge(task, errors[key])
            elif task.identity not in done:  # its result died with a worker: it runs again
                self._watch(future, task)
            elif not done[task.identity]:  # together they could not run
                self._waiting.extend(task.alone())
        return rows

    def _results(self, futures: Sequence[Any]) -> list[WorkerAnswer]:
        """Return answers of tasks that have ended; a row that died with its worker is awaited."""
        coroutine = self._client.gather(list(futures), errors="skip", asynchronous=True)
        answer = asyncio.run_coroutine_threadsafe(coroutine, self._client.loop.asyncio_loop)
        try:
            while not wait([answer], timeout=POLL_INTERVAL_S).done:
                self._presence.check()
            return list(answer.result())
        finally:
            answer.cancel()

    def _judge(self, task: WorkerTask, error: BaseException | None) -> list[Row]:
        """Decide on a task that gave no row: suspect it, give it up, or end the study."""
        from distributed import KilledWorker

        if isinstance(error, CarosacError):
            raise error
        if not isinstance(error, KilledWorker):
            raise LostScheduler(
                f"no worker could run the case {task.identity}: {type(error).__name__}: {error}"
            ) from error
        if self._alone is None:  # its neighbours on the same worker are suspects as well
            self._suspects.extend(task.alone())
            return []
        return [crashed_row(Case.from_dict(task.cases[0]), error.allowed_failures + 1)]
