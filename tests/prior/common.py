"""Clouds and masks in the axes of a view, and weights that do something."""

import numpy as np

from tso_cli.prior.features import CELL, GRID, HALF, Sight
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
    """Clouds, and a `Sight` of masks that are discs; a wall at z = .1 in half of the depth map."""
    rng = np.random.default_rng(seed)
    cloud = rng.uniform(-0.5, 0.5, (batch, points, 3)) * [1.0, 0.5, 0.7]
    centres = (np.arange(GRID) + 0.5) * CELL - HALF
    x, y = np.meshgrid(centres, centres)
    distance = np.stack([np.hypot(x, y) - radius for radius in rng.uniform(0.2, 0.5, batch)])
    closeness, known = rng.uniform(0.2, 0.6, batch), np.ones_like(distance)
    places, counted = rng.uniform(-0.2, 0.2, (batch, cells, 2)), np.ones((batch, cells))
    depth, measured = np.full_like(distance, 0.1), np.broadcast_to(x > 0.0, distance.shape)
    return cloud, Sight(
        closeness=closeness,
        distance=distance,
        known=known,
        cells=places,
        counted=counted,
        depth=depth,
        measured=measured.astype(float),
        metric=np.ones(batch),
        size=rng.uniform(8.0, 400.0, batch),
    )


def pushing(*displacement):
    """A prior that always asks for one displacement, in the axes of the view."""
    weights = {name: np.zeros(shape) for name, shape in shapes().items()}
    weights["moved.offset"][:3] = np.array(displacement) / SCALE
    return LearnedPrior(weights)
