"""Choosing where torch computes."""

from __future__ import annotations

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
        available = (
            f"{torch.cuda.device_count()} CUDA devices"
            if torch.cuda.is_available()
            else "no CUDA device"
        )
        raise InputError(
            f"--device {name}: not available here (found the CPU and {available})"
        ) from None
    return device
