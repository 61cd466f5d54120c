"""Independent pieces of work in other processes. If one dies, only its own piece is lost."""

from .each import Ended, Here, each, is_death
from .pool import WorkerDied, WorkerPool, cores

__all__ = ["Ended", "Here", "WorkerDied", "WorkerPool", "cores", "each", "is_death"]
