"""Short optimisations, loosely held and without detail, whose final losses are compared."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..cloud.smooth_field import SmoothField
from .field_optimisation import optimise_field
from .presets import COMPARISON, COMPARISON_RATE, COMPARISON_STEPS
from .problem import Problem


def final_losses(
    problems: Sequence[Problem], weights: Sequence[float], field: SmoothField
) -> list[float]:
    """The losses that problems of the same cloud end with after a few steps.

    ``weights`` are of the given views; ``field`` is of the start.

    Raises KeyboardInterrupt where Ctrl-C ended one of them.
    """
    losses = []
    for problem in problems:
        optimised = optimise_field(
            problem, weights, field, COMPARISON, COMPARISON_RATE, COMPARISON_STEPS
        )
        if optimised.interrupted:
            raise KeyboardInterrupt
        # `best_loss` has no position prior, which says how far the cloud had to move.
        losses.append(float(np.nanmin(optimised.losses)))
    return losses
