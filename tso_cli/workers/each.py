"""Many pieces of work on any executor; each ends with a result or an error."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Executor, wait
from concurrent.futures import Future as _Future
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from .pool import WorkerDied

Job = TypeVar("Job")
# dask's scheduler raises it if workers die with a task; its module is only there with dask.
_KILLED = "KilledWorker"
# A task on an engine far away should take some seconds, as each costs a message to its scheduler.
MOST_IN_A_TASK = 200


@dataclass(frozen=True)
class Ended(Generic[Job]):
    """What became of a job. ``error`` is None if there is a ``result``.

    deaths : how often the process that had the job died.
    """

    job: Job
    result: Any
    error: BaseException | None
    deaths: int = 0

    @property
    def failure(self) -> str:
        """The error in words, and how often a process died, if it was more than once."""
        words = str(self.error) or type(self.error).__name__
        # The words of another engine are about its tasks.
        if is_death(self.error) and not isinstance(self.error, WorkerDied):
            words = "its process died"
        return f"{words}, {self.deaths} times" if self.deaths > 1 else words


@dataclass
class _Task(Generic[Job]):
    """Jobs that are sent together; there are several only until one of them kills its process."""

    jobs: list[Job]
    deaths: int = 0


def each(
    executor: Executor,
    work: Callable[[Job], Any],
    jobs: Iterable[Job],
    window: int,
    *,
    last: Iterable[Job] = (),
    on_start: Callable[[Job, int], None] = lambda job, deaths: None,
    on_return: Callable[[Job], None] = lambda job: None,
    stopping: Callable[[], bool] = lambda: False,
    task_seconds: float = 0.0,
    instead: Callable[[], Executor] | None = None,
) -> Iterator[Ended[Job]]:
    """Do all ``jobs`` and yield them as they end. Nothing that one job does loses another.

    If a process dies, its job is tried once more. If a process dies with it again, the job waits
    until all others have ended and is then tried alone: perhaps it only needs the whole memory. If
    it kills its process even then, it ends with that error. Other exceptions are the job's result
    and are not tried again.

    Parameters
    ----------
    window : how many tasks are with the executor at once. ``jobs`` is read no further.
    last : jobs that are done at the end, each alone, as if they had killed two processes.
    on_start : called with a job and its deaths before it is given to the executor.
    on_return : called with a job that the executor gives back without having begun it.
    stopping : once it is true, no job begins; the jobs at work end.
    task_seconds : jobs are sent together so that a task takes about so long, as the tasks before
        it (`MOST_IN_A_TASK` jobs at most).
    instead : makes the executor that goes on if this one breaks as a whole, as that of
        `concurrent.futures` does once one of its processes dies. What was with it counts as
        untried, because nobody knows which job did it.
    """
    source = iter(jobs)
    again: deque[_Task[Job]] = deque()
    alone = deque(_Task([job], 2) for job in last)
    at_work: dict[_Future[Any], _Task[Job]] = {}
    pace = _Pace(task_seconds)
    exhausted = replaced = False

    def start(task: _Task[Job]) -> None:
        for job in task.jobs:
            on_start(job, task.deaths)
        try:
            future = executor.submit(_all, work, task.jobs)
        except BrokenExecutor as error:  # not one of its processes, but all of it
            future = _Future()
            future.set_exception(error)
        at_work[future] = task

    def went_with_all(error: BaseException) -> bool:
        nonlocal executor, replaced
        if isinstance(error, WorkerDied) or not isinstance(error, BrokenExecutor):
            return False
        if instead and not replaced and _is_broken(executor):
            executor, replaced = instead(), True
        return replaced

    while True:
        while len(at_work) < window and not stopping():
            if again:
                start(again.popleft())
                continue
            jobs_of_task: list[Job] = []
            while not exhausted and len(jobs_of_task) < pace.jobs:
                job = next(source, None)
                exhausted = job is None
                if job is not None:
                    jobs_of_task.append(job)
            if not jobs_of_task:
                break
            start(_Task(jobs_of_task))
        if not at_work:
            if not alone or stopping():
                return
            start(alone.popleft())
        if stopping():
            for future in at_work:
                future.cancel()
        for future in wait(at_work, return_when=FIRST_COMPLETED).done:
            task = at_work.pop(future)
            try:
                results, seconds = future.result()
                pace.add(seconds, len(task.jobs))
            except CancelledError:
                for job in task.jobs:
                    on_return(job)
                continue
            except BaseException as error:
                if not is_death(error):
                    yield from (Ended(job, None, error, task.deaths) for job in task.jobs)
                elif went_with_all(error):
                    (again if task.deaths < 2 else alone).append(task)
                elif task.deaths == 2:
                    yield from (Ended(job, None, error, task.deaths + 1) for job in task.jobs)
                else:
                    queue = alone if task.deaths == 1 else again
                    queue.extend(_Task([job], task.deaths + 1) for job in task.jobs)
                continue
            for job, (result, failure) in zip(task.jobs, results, strict=True):
                yield Ended(job, result, failure, task.deaths)


class _Pace:
    """How many jobs go into a task, from the seconds that jobs took so far."""

    def __init__(self, task_seconds: float) -> None:
        self._wanted, self._sum, self._count = task_seconds, 0.0, 0

    def add(self, seconds: float, jobs: int) -> None:
        self._sum, self._count = self._sum + seconds, self._count + jobs

    @property
    def jobs(self) -> int:
        if not self._wanted or not self._sum:
            return 1
        return max(1, min(MOST_IN_A_TASK, int(self._wanted * self._count / self._sum)))


def _all(
    work: Callable[[Job], Any], jobs: list[Job]
) -> tuple[list[tuple[Any, BaseException | None]], float]:
    """The result or the exception of each job, and the seconds of all; Ctrl-C ends the task."""
    ended: list[tuple[Any, BaseException | None]] = []
    begun = time.perf_counter()
    for job in jobs:
        try:
            ended.append((work(job), None))
        except Exception as error:
            ended.append((None, error))
    return ended, time.perf_counter() - begun


def is_death(error: BaseException | None) -> bool:
    """Whether a process died, and perhaps not because of the job that it had."""
    return isinstance(error, BrokenExecutor) or type(error).__name__ == _KILLED


def _is_broken(executor: Executor) -> bool:
    """Whether an executor takes no more work because it broke."""
    try:
        executor.submit(int).cancel()
    except BrokenExecutor:
        return True
    return False


class Here(Executor):
    """An executor without processes: `submit` does the work."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> _Future[Any]:
        future: _Future[Any] = _Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future
