"""Chooses where torch computes."""

from __future__ import annotations

from typing import TYPE_CHECKING

from .errors import InputError

if TYPE_CHECKING:
    import torch


def resolve(name: str) -> torch.device:
    """The torch device ``name``: "cpu", "cuda", "cuda:1", "mps" or "auto".

    "auto" is CUDA if it is available, otherwise the CPU. Raises InputError if the device is not
    available.
    """
    import torch

    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    try:
        device = torch.device(name)
        # Reading a value back fails for "meta", whose tensors have no data.
        torch.ones(1, device=device).item()
    except (RuntimeError, AssertionError, NotImplementedError):
        count = torch.cuda.device_count() if torch.cuda.is_available() else 0
        available = f"{count} CUDA devices" if count else "no CUDA device"
        raise InputError(
            f"`device` {name}: not available here (found the CPU and {available}), "
            "expected a device that is"
        ) from None
    return device
