"""Choosing where torch computes."""

from __future__ import annotations

from typing import TYPE_CHECKING

from .errors import InputError

if TYPE_CHECKING:
    import torch


def resolve(name: str) -> torch.device:
    """The torch device called ``name``: "cpu", "cuda", "cuda:1", "mps", or "auto" (CUDA where there is one).

    Raises InputError if it does not exist here.
    """
    import torch

    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    try:
        device = torch.device(name)
        torch.empty(1, device=device)
    except (RuntimeError, AssertionError, NotImplementedError):
        found = f"{torch.cuda.device_count()} CUDA devices" if torch.cuda.is_available() else "no CUDA device"
        raise InputError(f"--device {name}: not available here (found the CPU and {found})") from None
    return device
