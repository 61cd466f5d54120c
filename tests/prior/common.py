"""Clouds and masks in the axes of a view, and weights that do something."""

import numpy as np

from tso_cli.prior.features import CELL, GRID, HALF
from tso_cli.prior.learned import LearnedPrior
from tso_cli.prior.network import SCALE, initial, shapes


def some_weights(seed=0):
    """Random weights, float64; those of `initial` move nothing."""
    rng = np.random.default_rng(seed)
    return {
        name: (array + 0.05 * rng.standard_normal(array.shape)).astype(float)
        for name, array in initial(seed).items()
    }


def discs(batch=2, points=512, cells=300, seed=0):
    """The arguments of `features` but the number of nodes: clouds, and masks that are discs."""
    rng = np.random.default_rng(seed)
    cloud = rng.uniform(-0.5, 0.5, (batch, points, 3)) * [1.0, 0.5, 0.7]
    centres = (np.arange(GRID) + 0.5) * CELL - HALF
    x, y = np.meshgrid(centres, centres)
    distance = np.stack([np.hypot(x, y) - radius for radius in rng.uniform(0.2, 0.5, batch)])
    closeness, known = rng.uniform(0.2, 0.6, batch), np.ones_like(distance)
    places, counted = rng.uniform(-0.2, 0.2, (batch, cells, 2)), np.ones((batch, cells))
    return cloud, closeness, distance, known, places, counted


def pushing(*displacement):
    """A prior that always asks for one displacement, in the axes of the view."""
    weights = {name: np.zeros(shape) for name, shape in shapes().items()}
    weights["moved.offset"][:3] = np.array(displacement) / SCALE
    return LearnedPrior(weights)
