"""What the views of a batch show: masks, depth maps and cameras as people have them."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from ...geometry.arrays import Array, Bits, Indices
from ...geometry.rotations import from_vectors
from ...prior.network import TROUBLES
from .bank import Bank
from .masks import SCENE_GRID

# Of all views: a camera that is off by a rotation, a zoom and a shift, each of these deviations.
CAMERA_SHARE, CAMERA = 0.12, (0.04, 0.04, 0.02)
UNRELATED_SHARE = 0.02  # of all views: what is seen is another scene
# Of views with a depth map: fitted maps; deviations of the noise of cells and of the relief; maps
# with holes, and the most cells that are holes.
FITTED_SHARE, CELL_NOISE, RELIEF_NOISE, HOLES_SHARE, MOST_HOLES = 0.5, 0.02, 0.1, 0.5, 0.5
NOISY_SHARE = 0.6
DEPTH_SHARE = 0.8  # of the views of a scene with depth maps
DISTANCE_NOISE = 0.002  # one number for each map: an outline that is drawn too wide or too narrow


def what_views_show(
    bank: Bank, scene: Indices, of_clouds: dict[str, Bits], rng: np.random.Generator
) -> dict[str, Tensor]:
    """What the views of the scenes show, by the names of a `Batch`."""
    shape = (len(scene), bank.rotation.shape[1])
    unrelated = rng.random(shape) < UNRELATED_SHARE
    seen = np.where(unrelated, rng.integers(len(bank.shape), size=shape), scene[:, None])
    rows, view = bank.tensor(seen), torch.arange(shape[1], device=bank.device)
    distance, known = _maps(bank, rows, view, rng)
    foreign, hidden = (maps[rows, view].float() for maps in (bank.foreign, bank.hidden))
    depth, metric = _depths(bank, seen, unrelated, rng)
    off = rng.random(shape) < CAMERA_SHARE
    turn, zoom, shift = (
        rng.normal(0.0, spread, (*shape, size)) * off[..., None]
        for spread, size in zip(CAMERA, (3, 1, 2), strict=True)
    )
    turns = bank.tensor(from_vectors(turn))
    of_views = {
        "camera": off,
        "foreign": foreign.flatten(2).amax(2).cpu().numpy() > 0.0,
        "hidden": hidden.flatten(2).amax(2).cpu().numpy() > 0.0,
        "outline": bank.outline[rows, view].cpu().numpy(),
        "unrelated": unrelated,
    }
    for name, of_cloud in of_clouds.items():
        of_views[name] = np.broadcast_to(of_cloud[:, None], shape)
    troubles = np.stack([of_views[name] for name in TROUBLES], -1)
    return {
        # Of the scene, also for a view that shows another: that is the trouble.
        "rotation": turns @ bank.rotation[bank.tensor(scene)],
        "closeness": bank.closeness[bank.tensor(scene)].float(),
        "zoom": bank.tensor(np.exp(zoom[..., 0])),
        "shift": bank.tensor(shift),
        "distance": distance,
        "known": known,
        "foreign": foreign,
        "hidden": hidden,
        "depth": depth,
        "metric": metric,
        "size": bank.size[rows, view].float(),
        "troubles": bank.tensor(troubles.astype(np.float32)),
    }


def _depths(
    bank: Bank, scene: Indices, unrelated: Bits, rng: np.random.Generator
) -> tuple[Tensor, Tensor]:
    """Depth maps as devices and networks give them [B, V, G, G], and which are metric [B, V]."""
    row = bank.of_depth[scene]
    has_map = (row >= 0) & ~unrelated & (rng.random(scene.shape) < DEPTH_SHARE)
    metric = has_map & (rng.random(scene.shape) >= FITTED_SHARE)
    maps = torch.full((*scene.shape, SCENE_GRID, SCENE_GRID), torch.nan, device=bank.device)
    places = np.argwhere(has_map)
    if len(places):
        at, view = bank.tensor(places[:, 0]), bank.tensor(places[:, 1])
        depth = bank.depth[bank.tensor(row[has_map]), view].float()
        size = (len(places), SCENE_GRID, SCENE_GRID)
        noisy = rng.random(len(places)) < NOISY_SHARE
        scale = [rng.uniform(0.0, most, len(places)) * noisy for most in (CELL_NOISE, RELIEF_NOISE)]
        cell, relief = (
            bank.tensor(values[:, None, None] * field)
            for values, field in zip(
                scale, (rng.normal(size=size), _smooth(rng, size[0])), strict=True
            )
        )
        middle = depth.flatten(1).nanmean(1)[:, None, None]
        depth = depth + cell + relief * 0.5 + relief * (depth - middle)
        holes = rng.uniform(0.0, MOST_HOLES, len(places)) * (rng.random(len(places)) < HOLES_SHARE)
        field = _smooth(rng, size[0])
        bound = np.array([np.quantile(f, h) for f, h in zip(field, holes, strict=True)])
        hole = bank.tensor((field < bound[:, None, None]) & (holes > 0.0)[:, None, None])
        maps[at, view] = torch.where(hole, torch.nan, depth)
    return maps, bank.tensor(metric.astype(np.float32))


def _smooth(rng: np.random.Generator, count: int) -> Array:
    """[count, SCENE_GRID, SCENE_GRID] of smooth noise of deviation 1."""
    coarse = torch.from_numpy(rng.normal(size=(count, 1, 7, 7)))
    size = (SCENE_GRID, SCENE_GRID)
    smooth = functional.interpolate(coarse, size, mode="bicubic", align_corners=True)[:, 0]
    return smooth.numpy()


def _maps(
    bank: Bank, rows: Tensor, view: Tensor, rng: np.random.Generator
) -> tuple[Tensor, Tensor]:
    """Signed distances and what is known of them, [B, VIEWS, SCENE_GRID, SCENE_GRID] each."""
    distance = bank.distance[rows, view].float()
    noise = rng.normal(0.0, DISTANCE_NOISE, (*distance.shape[:2], 1, 1))
    window = bank.window[rows, view][:, :, :, None]
    place = torch.arange(SCENE_GRID, device=bank.device)
    columns = (place >= window[:, :, 0]) & (place < window[:, :, 2])
    lines = (place >= window[:, :, 1]) & (place < window[:, :, 3])
    return distance + bank.tensor(noise), (lines[..., :, None] & columns[..., None, :]).float()
