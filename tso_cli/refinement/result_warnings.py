"""What to know of a result before it is used: that nothing moved and why, and what is to be doubted."""

from __future__ import annotations

from collections.abc import Sequence

from ..geometry.view import View
from .config import RefineResult
from .placement import mask_doubts

# A view that is trusted less is warned of.
DOUBTED = 0.5
# Less than this share of the object's size is hardly a movement.
HARDLY = 1e-3


def unmoved(result: RefineResult) -> str | None:
    """Why no point moved, in words; None where points did."""
    if result.best_step:
        return None
    shows = "the mask shows" if len(result.cameras) == 1 else "the masks show"
    return {
        "max_steps": "no steps were asked for",
        "interrupted": f"interrupted at step {result.steps}, before one lowered the loss",
        "non_finite": f"the loss was no number after step {result.steps}, and none before was lower than that of the start",
        "nothing_to_do": f"the cloud already agrees with all that {shows}",
        "not_improved": f"none of {result.steps} steps agrees better with what {shows} than the start does",
    }[result.stop_reason]


def remarks(result: RefineResult, views: Sequence[View], steps: int) -> tuple[str, ...]:
    """The ``warnings`` of a result, whose own are not there yet; ``steps`` : how many were asked for."""
    found = []
    if why := unmoved(result):
        found.append(f"nothing {'to do' if result.stop_reason == 'nothing_to_do' else 'moved'}: {why}; the cloud is as it was")
    elif result.stop_reason == "interrupted":
        found.append(f"interrupted at step {result.steps} of {steps}: the result is the best so far")
    elif result.stop_reason == "non_finite":
        found.append(f"the loss was no number after step {result.steps}: the result is the best before that")
    elif result.moved_max < HARDLY:
        found.append(f"hardly anything moved: no point by more than {100.0 * HARDLY:g} % of the object's size")
    for view in views:
        found += mask_doubts(view, result.surface_samples or len(result.points))
    found += [
        f"{view.name}: the other views contradict it, so it counts for little (trust {trust:.2f} of 1); is its mask or camera "
        "wrong?"
        for view, trust in zip(views, result.view_trust, strict=True)
        if trust < DOUBTED
    ]
    return tuple(found)
