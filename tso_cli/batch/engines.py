"""What does the work of a batch: processes of this machine, or a cluster of dask."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from ..errors import TsoError, needed_by
from ..io.output import reason
from ..workers import WorkerPool

# Items read ahead for each process.
AHEAD = 2
# A task that travels to a scheduler should take about so long.
TASK_SECONDS = 5.0
# How long to wait for a first worker of a cluster.
PATIENCE = 60


@dataclass(frozen=True)
class Engine:
    """``window`` : tasks that are with the executor at once. ``task_seconds`` : as in `each`."""

    executor: Executor
    window: int
    task_seconds: float = 0.0


@contextmanager
def engine(
    name: str, processes: int, scheduler: str | None, seconds: float | None = None
) -> Iterator[Engine]:
    """The engine ``name`` while it is used; a process of this machine may need ``seconds``."""
    if name == "dask":
        with _dask(processes, scheduler) as cluster:
            yield cluster
        return
    pool = WorkerPool(processes, seconds)
    try:
        yield Engine(pool, AHEAD * processes)
    finally:
        pool.shutdown(wait=False)


@contextmanager
def _dask(processes: int, scheduler: str | None) -> Iterator[Engine]:
    with needed_by("`engine` dask needs"):
        import dask
        from distributed import Client, LocalCluster
    # A task whose worker dies comes back at once, and `each` decides what is tried again. With more
    # failures allowed, a task that kills its worker would kill several.
    settings = {
        "distributed.scheduler.allowed-failures": 0,
        "distributed.comm.timeouts.connect": "5s",
        "distributed.worker.daemon": False,
        # A worker would keep a profile of each second of an hour, a quarter of a megabyte each.
        "distributed.worker.profile.enabled": False,
    }
    with dask.config.set(settings):
        cluster: Any = None
        if not scheduler:
            cluster = LocalCluster(
                n_workers=processes,
                threads_per_worker=1,
                dashboard_address=None,
                silence_logs=logging.CRITICAL,
            )
        try:
            client = Client(scheduler or cluster)
            client.wait_for_workers(1, timeout=PATIENCE)
        except (OSError, TimeoutError, ValueError) as error:
            where = f"no worker of {scheduler}" if scheduler else "no worker"
            raise TsoError(f"{where} can be reached ({reason(error)})") from None
        try:
            # No result is taken for that of another task with the same arguments.
            executor = client.get_executor(pure=False, retries=0)
            yield Engine(executor, AHEAD * sum(client.ncores().values()), TASK_SECONDS)
        finally:
            client.close()
            if cluster is not None:
                cluster.close()
