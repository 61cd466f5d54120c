"""Choosing where torch computes."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from .errors import InputError

if TYPE_CHECKING:
    import torch


def resolve(name: str) -> torch.device:
    """The torch device ``name``: "cpu", "cuda", "cuda:1", "mps", or "auto" (CUDA if available, else the CPU).

    Raises InputError if it is not available.
    """
    import torch

    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    try:
        device = torch.device(name)
        # Reading a value back excludes "meta", whose tensors have no data.
        torch.ones(1, device=device).item()
    except (RuntimeError, AssertionError, NotImplementedError):
        available = f"{torch.cuda.device_count()} CUDA devices" if torch.cuda.is_available() else "no CUDA device"
        raise InputError(f"--device {name}: not available here (found the CPU and {available})") from None
    return device


@contextmanager
def one_thread(when: bool) -> Iterator[None]:
    """Limit torch to one CPU thread inside the block if ``when``.

    A step on a small cloud is a hundred operations of some microseconds each: more threads gain nothing on an idle machine,
    and on a busy one they wait for one another (five to ten times slower).
    """
    import torch

    before = torch.get_num_threads()
    if when:
        torch.set_num_threads(1)
    try:
        yield
    finally:
        if when:
            torch.set_num_threads(before)
