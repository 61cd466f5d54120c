"""Batches: starts that are wrong in the ways in which starts are wrong, and their scenes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ...geometry.arrays import Array, Bits, Indices
from .bank import Bank
from .masks import SCENE_GRID
from .shapes import POINTS
from .warps import STRENGTH, draw_lattices, warped

# Kinds of start; all that are neither right nor near are other shapes, or predictions of a network
# (`predictions.PREDICTED_SHARE`).
RIGHT_SHARE, NEAR_SHARE = 0.1, 0.2
NEAR_STRENGTH = (0.05, 0.7)  # of the deformation of a near start
NEAREST_SHARE = 0.4  # of the other shapes, among the nearest of the category
WARPED_SHARE = 0.4  # of the other shapes
# Of the other shapes: moved toward a third shape, with noise, as the prediction of a network is.
BLENDED_SHARE, BLEND, BLEND_NOISE = 0.2, (0.15, 0.6), 0.02
NORMALISED_SHARE = 0.85  # of the other shapes; the rest keep the frame that they have
# Of all starts: in a frame that is off, as that of a cloud is whose box is not the truth's.
SHIFTED_SHARE, SHIFT, SCALE = 0.15, 0.03, 0.06
# Of all starts: among their points some belong to nothing, up to this share, in a box of this size.
STREWN_CHANCE, MOST_STREWN, STREWN_BOX = 0.06, 0.08, 1.5
ALL_POINTS_CHANCE, LEAST_POINTS = 0.75, 128  # of a batch
DISTANCE_NOISE = 0.002  # one number for each map: an outline that is drawn too wide or too narrow


@dataclass(frozen=True, eq=False)
class Batch:
    """B starts with M points each and the views of their truths, float32 on one device.

    start : [B, M, 3], the points of the start in the frame of the truth, which is centred and has
        longest side 1; in random order.
    target : [B, POINTS, 3], samples of the truth.
    counterpart : [B, M, 3], where each point of the start belongs; NaN where that is not known.
    rotation : [B, VIEWS, 3, 3], from the frame of the truth to the view's axes.
    closeness : [B, VIEWS], u of `masks.seen`.
    distance : [B, VIEWS, SCENE_GRID, SCENE_GRID], see `masks.signed_distance`.
    known : [B, VIEWS, SCENE_GRID, SCENE_GRID], 1 where the picture shows the scene, 0 beyond its
        border.
    """

    start: Tensor
    target: Tensor
    counterpart: Tensor
    rotation: Tensor
    closeness: Tensor
    distance: Tensor
    known: Tensor


def draw(bank: Bank, rng: np.random.Generator, count: int) -> Batch:
    """A batch of ``count`` starts. All random numbers come from ``rng``, on any device."""
    scene = rng.integers(len(bank.shape), size=count)
    points = POINTS
    if rng.random() >= ALL_POINTS_CHANCE:
        points = int(rng.integers(LEAST_POINTS, POINTS + 1))
    side = rng.integers(2, size=count)
    target = bank.truths[_to(bank, scene), _to(bank, side)]
    sample = bank.truths[_to(bank, scene), _to(bank, 1 - side)][:, :points]
    kind = rng.random(count)
    near = (kind >= RIGHT_SHARE) & (kind < RIGHT_SHARE + NEAR_SHARE)
    other = kind >= RIGHT_SHARE + NEAR_SHARE
    predicted = other & (bank.prediction[scene] >= 0) & (kind >= 1.0 - bank.predicted_chance)
    start, shape = sample.clone(), bank.shape[scene]
    _warp(bank, start, shape, near, rng, NEAR_STRENGTH)
    _replace_by_others(bank, start, shape, other & ~predicted, rng)
    start[_to(bank, predicted)] = bank.predicted[_to(bank, bank.prediction[scene[predicted]])][
        :, :points
    ]
    counterpart = torch.where(_rows(bank, other), torch.nan, sample)
    _shift(start, rng)
    _strew(start, counterpart, rng)
    order = _to(bank, rng.random((count, points)).argsort(1))[..., None].expand(-1, -1, 3)
    start, counterpart = start.gather(1, order), counterpart.gather(1, order)
    distance, known = _maps(bank, scene, rng)
    batch = Batch(
        start,
        target,
        counterpart,
        bank.rotation[_to(bank, scene)],
        bank.closeness[_to(bank, scene)],
        distance,
        known,
    )
    return mirrored(batch, _to(bank, rng.random(count) < 0.5))


def _to(bank: Bank, array: NDArray[Any]) -> Tensor:
    """The array as a tensor on the bank's device; floating-point numbers in single precision."""
    tensor = torch.from_numpy(np.ascontiguousarray(array)).to(bank.device)
    return tensor.float() if tensor.is_floating_point() else tensor


def _rows(bank: Bank, chosen: Bits) -> Tensor:
    """``chosen`` [B] as a tensor [B, 1, 1]."""
    return _to(bank, chosen)[:, None, None]


def _warp(
    bank: Bank,
    start: Tensor,
    shape: Indices,
    chosen: Bits,
    rng: np.random.Generator,
    strength: tuple[float, float],
) -> None:
    """Deform the ``chosen`` rows of ``start``."""
    rows = np.flatnonzero(chosen)
    clouds = start[_to(bank, rows)]
    low, high = clouds.amin(1), clouds.amax(1)
    sizes = (high - low).cpu().numpy()
    lattices = draw_lattices(rng, sizes, bank.mirror_axes[shape[rows]], strength)
    start[_to(bank, rows)] = warped(clouds, low, high, _to(bank, lattices))


def _replace_by_others(
    bank: Bank, start: Tensor, shape: Indices, chosen: Bits, rng: np.random.Generator
) -> None:
    """Replace the ``chosen`` rows of ``start`` by other shapes of the category of ``shape``."""
    rows = np.flatnonzero(chosen)
    count, points = len(rows), start.shape[1]
    first, third = (_draw_others(bank, shape[rows], rng) for _ in range(2))
    clouds = bank.samplings[_to(bank, first), _to(bank, rng.integers(2, size=count))]
    clouds = clouds[:, :points]
    _warp(bank, clouds, first, rng.random(count) < WARPED_SHARE, rng, STRENGTH)
    _blend(bank, clouds, third, rng)
    normalised = _rows(bank, rng.random(count) < NORMALISED_SHARE)
    start[_to(bank, rows)] = torch.where(normalised, _normalised(clouds), clouds)


def _draw_others(bank: Bank, shape: Indices, rng: np.random.Generator) -> Indices:
    """For each ``shape`` [B] another shape of its category, of another kind."""
    neighbours = bank.neighbours
    nearest = rng.random(len(shape)) < NEAREST_SHARE
    choices = np.where(nearest, neighbours.near[shape], neighbours.eligible[shape])
    return neighbours.order[shape, rng.integers(choices)].astype(np.int64)


def _blend(bank: Bank, clouds: Tensor, third: Indices, rng: np.random.Generator) -> None:
    """Move some of ``clouds`` toward their nearest points in the shapes ``third``, with noise."""
    rows = np.flatnonzero(rng.random(len(third)) < BLENDED_SHARE)
    share = rng.uniform(*BLEND, (len(rows), 1, 1))
    noise = rng.normal(0.0, 1.0, (len(rows), clouds.shape[1], 3))
    noise *= rng.uniform(0.0, BLEND_NOISE, (len(rows), 1, 1))
    moved, toward = clouds[_to(bank, rows)], bank.samplings[_to(bank, third[rows]), 0]
    index = torch.cdist(moved, toward).argmin(2)[..., None].expand(-1, -1, 3)
    moved += _to(bank, share) * (toward.gather(1, index) - moved) + _to(bank, noise)
    clouds[_to(bank, rows)] = moved


def _normalised(clouds: Tensor) -> Tensor:
    """``clouds`` [B, N, 3] centred, with longest side 1."""
    low, high = clouds.amin(1, keepdim=True), clouds.amax(1, keepdim=True)
    return (clouds - (low + high) / 2.0) / (high - low).amax(2, keepdim=True).clamp_min(1e-6)


def _shift(start: Tensor, rng: np.random.Generator) -> None:
    """Scale and shift some of the starts."""
    count = len(start)
    chosen = (rng.random(count) < SHIFTED_SHARE)[:, None, None]
    scale = 1.0 + rng.normal(0.0, SCALE, (count, 1, 1)) * chosen
    shift: Array = rng.normal(0.0, SHIFT, (count, 1, 3)) * chosen
    numbers = (torch.from_numpy(values).to(start) for values in (scale, shift))
    start.mul_(next(numbers)).add_(next(numbers))


def _strew(start: Tensor, counterpart: Tensor, rng: np.random.Generator) -> None:
    """Replace the first points of some starts by random ones: a single one as often as many."""
    count, points = start.shape[:2]
    share = np.exp(rng.uniform(np.log(1.0 / points), np.log(MOST_STREWN), count))
    number = np.ceil(share * points) * (rng.random(count) < STREWN_CHANCE)
    places = STREWN_BOX * (rng.random((count, points, 3)) - 0.5)
    chosen = torch.from_numpy(np.arange(points) < number[:, None])[..., None].to(start.device)
    start.copy_(torch.where(chosen, torch.from_numpy(places).to(start), start))
    counterpart.masked_fill_(chosen, torch.nan)


def _maps(bank: Bank, scene: Indices, rng: np.random.Generator) -> tuple[Tensor, Tensor]:
    """Signed distances and what is known of them, [B, VIEWS, SCENE_GRID, SCENE_GRID] each."""
    distance = bank.distance[_to(bank, scene)].float()
    noise = rng.normal(0.0, DISTANCE_NOISE, (*distance.shape[:2], 1, 1))
    window = bank.window[_to(bank, scene)][:, :, :, None]
    place = torch.arange(SCENE_GRID, device=bank.device)
    columns = (place >= window[:, :, 0]) & (place < window[:, :, 2])
    rows = (place >= window[:, :, 1]) & (place < window[:, :, 3])
    return distance + _to(bank, noise), (rows[..., :, None] & columns[..., None, :]).float()


def mirrored(batch: Batch, chosen: Tensor) -> Batch:
    """The batch with the ``chosen`` rows [B] mirrored, x -> -x in the object and in its views.

    With S = diag(-1, 1, 1) a point S x is seen at S R x, so the rotation becomes S R S.
    """
    sign = torch.where(chosen, -1.0, 1.0)[:, None]
    flip = torch.stack([sign, torch.ones_like(sign), torch.ones_like(sign)], 2)  # [B, 1, 3]

    def flipped(maps: Tensor) -> Tensor:
        return torch.where(chosen[:, None, None, None], maps.flip(-1), maps)

    return Batch(
        batch.start * flip,
        batch.target * flip,
        batch.counterpart * flip,
        batch.rotation * flip[:, None] * flip[:, None].mT,
        batch.closeness,
        flipped(batch.distance),
        flipped(batch.known),
    )
