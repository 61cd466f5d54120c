"""Independent pieces of work in other processes, none of which can lose the work of another."""

from .each import Ended, Here, each, is_death
from .pool import WorkerDied, WorkerPool, cores

__all__ = ["Ended", "Here", "WorkerDied", "WorkerPool", "cores", "each", "is_death"]
