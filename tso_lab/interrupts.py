"""Ctrl-C ends a study, and no number is made of what a refinement or a training kept after it."""

from __future__ import annotations

from typing import TypeVar

from tso_cli.errors import Interrupted

T = TypeVar("T")


def uninterrupted(result: T) -> T:
    """What `refine`, an item of `refine_batch` or `train` returned.

    Raises KeyboardInterrupt where Ctrl-C ended it: those functions keep the best so far.
    """
    outcome = getattr(result, "fit", result)
    if getattr(outcome, "stop_reason", "") == "interrupted" or isinstance(result, Interrupted):
        raise KeyboardInterrupt
    return result
