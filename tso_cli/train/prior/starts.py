"""Batches: starts that are wrong in the ways in which starts are wrong, and their scenes."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from ...geometry.arrays import Array, Bits, Indices
from ...geometry.rotations import from_vectors
from ...prior.torch_backend import TORCH
from .bank import Bank
from .shapes import POINTS
from .shown import what_views_show
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
ANY_SHARE = 0.06  # of the other shapes: of any category
# Of all starts: in a frame that is off, as that of a cloud is whose box is not the truth's, or that
# somebody has placed.
SHIFTED_SHARE, SHIFT, SCALE = 0.2, 0.03, 0.06
TURNED_SHARE, TURN = 0.5, 0.07  # of these, about a random axis; radians, standard deviation
# Of all starts: points on a plane, which are not the object's, up to this share.
PLANE_SHARE, MOST_ON_PLANE, PLANE_SIDE = 0.06, 0.35, (1.0, 2.0)
# Of all starts: the points are up to e^this times as dense at an end as at the other.
UNEVEN_SHARE, UNEVEN = 0.3, 4.0
# Of all starts: among their points some belong to nothing, up to this share, in a box of this size.
STREWN_CHANCE, MOST_STREWN, STREWN_BOX = 0.06, 0.08, 1.5
ALL_POINTS_CHANCE, LEAST_POINTS = 0.75, 64  # of a batch


@dataclass(frozen=True, eq=False)
class Batch:
    """B starts with M points each and the views of their truths, float32 on one device.

    start : [B, M, 3], the points of the start in the frame of the truth, which is centred and has
        longest side 1; in random order.
    target : [B, POINTS, 3], samples of the truth.
    counterpart : [B, M, 3], where each point of the start belongs; NaN where that is not known.
    foreign_points : [B, M], 1 for points that are not the object's; their counterparts are where
        they are.
    rotation : [B, VIEWS, 3, 3], from the frame of the truth to the view's axes, as it is given.
    closeness : [B, VIEWS], u of `masks.seen`.
    zoom, shift : [B, VIEWS] and [B, VIEWS, 2]: a place w of the given camera is at zoom w + shift
        in the maps.
    distance, known, foreign, hidden : [B, VIEWS, SCENE_GRID, SCENE_GRID], see
        `masks.signed_distance`; 1 where the picture shows the scene, 0 beyond its border; and see
        `troubles.Marred`.
    depth : [B, VIEWS, SCENE_GRID, SCENE_GRID], NaN where there is none.
    metric : [B, VIEWS], 1 for a depth map that is not to be fitted.
    size : [B, VIEWS], the longest side of the truth in pixels.
    troubles : [B, VIEWS, T], 1 for each of `prior.network.TROUBLES` that is the case.
    """

    start: Tensor
    target: Tensor
    counterpart: Tensor
    foreign_points: Tensor
    rotation: Tensor
    closeness: Tensor
    zoom: Tensor
    shift: Tensor
    distance: Tensor
    known: Tensor
    foreign: Tensor
    hidden: Tensor
    depth: Tensor
    metric: Tensor
    size: Tensor
    troubles: Tensor


def draw(bank: Bank, rng: np.random.Generator, count: int) -> Batch:
    """A batch of ``count`` starts. All random numbers come from ``rng``, on any device."""
    scene = rng.integers(len(bank.shape), size=count)
    points = POINTS
    if rng.random() >= ALL_POINTS_CHANCE:
        points = int(np.exp(rng.uniform(np.log(LEAST_POINTS), np.log(POINTS))))
    side = rng.integers(2, size=count)
    target = bank.truths[bank.tensor(scene), bank.tensor(side)]
    sample = bank.truths[bank.tensor(scene), bank.tensor(1 - side)]
    kind = rng.random(count)
    near = (kind >= RIGHT_SHARE) & (kind < RIGHT_SHARE + NEAR_SHARE)
    other = kind >= RIGHT_SHARE + NEAR_SHARE
    predicted = other & (bank.prediction[scene] >= 0) & (kind >= 1.0 - bank.predicted_chance)
    start, shape = sample.clone(), bank.shape[scene]
    _warp(bank, start, shape, near, rng, NEAR_STRENGTH)
    _replace_by_others(bank, start, shape, other & ~predicted, rng)
    start[bank.tensor(predicted)] = bank.predicted[bank.tensor(bank.prediction[scene[predicted]])]
    counterpart = torch.where(_rows(bank, other), torch.nan, sample)
    moved = _move(start, rng)
    chosen = bank.tensor(_chosen(start, points, rng))[..., None].expand(-1, -1, 3)
    start, counterpart = start.gather(1, chosen), counterpart.gather(1, chosen)
    _strew(start, counterpart, rng)
    foreign_points, with_plane = _add_plane(start, counterpart, rng)
    order = bank.tensor(rng.random((count, points)).argsort(1))
    foreign_points = foreign_points.gather(1, order)
    order = order[..., None].expand(-1, -1, 3)
    start, counterpart = start.gather(1, order), counterpart.gather(1, order)
    of_clouds = {"shape": near | other, "moved": moved, "plane": with_plane}
    views = what_views_show(bank, scene, of_clouds, rng)
    batch = Batch(start, target, counterpart, foreign_points, **views)
    return mirrored(batch, bank.tensor(rng.random(count) < 0.5))


def _rows(bank: Bank, chosen: Bits) -> Tensor:
    """``chosen`` [B] as a tensor [B, 1, 1]."""
    return bank.tensor(chosen)[:, None, None]


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
    clouds = start[bank.tensor(rows)]
    low, high = clouds.amin(1), clouds.amax(1)
    sizes = (high - low).cpu().numpy()
    lattices = draw_lattices(rng, sizes, bank.mirror_axes[shape[rows]], strength)
    start[bank.tensor(rows)] = warped(clouds, low, high, bank.tensor(lattices))


def _replace_by_others(
    bank: Bank, start: Tensor, shape: Indices, chosen: Bits, rng: np.random.Generator
) -> None:
    """Replace the ``chosen`` rows of ``start`` by other shapes of the category of ``shape``."""
    rows = np.flatnonzero(chosen)
    count = len(rows)
    first, third = (_draw_others(bank, shape[rows], rng) for _ in range(2))
    any_shape = rng.integers(len(bank.samplings), size=count)
    first = np.where(rng.random(count) < ANY_SHARE, any_shape, first)
    clouds = bank.samplings[bank.tensor(first), bank.tensor(rng.integers(2, size=count))]
    _warp(bank, clouds, first, rng.random(count) < WARPED_SHARE, rng, STRENGTH)
    _blend(bank, clouds, third, rng)
    normalised = _rows(bank, rng.random(count) < NORMALISED_SHARE)
    start[bank.tensor(rows)] = torch.where(normalised, _normalised(clouds), clouds)


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
    moved, toward = clouds[bank.tensor(rows)], bank.samplings[bank.tensor(third[rows]), 0]
    index = TORCH.nearest(moved, toward)[..., None].expand(-1, -1, 3)
    moved += bank.tensor(share) * (toward.gather(1, index) - moved) + bank.tensor(noise)
    clouds[bank.tensor(rows)] = moved


def _normalised(clouds: Tensor) -> Tensor:
    """``clouds`` [B, N, 3] centred, with longest side 1."""
    low, high = clouds.amin(1, keepdim=True), clouds.amax(1, keepdim=True)
    return (clouds - (low + high) / 2.0) / (high - low).amax(2, keepdim=True).clamp_min(1e-6)


def _move(start: Tensor, rng: np.random.Generator) -> Bits:
    """Scale, turn and shift some of the starts; which of them, [B]."""
    count = len(start)
    chosen: Bits = rng.random(count) < SHIFTED_SHARE
    turned = chosen & (rng.random(count) < TURNED_SHARE)
    scale = 1.0 + rng.normal(0.0, SCALE, (count, 1, 1)) * chosen[:, None, None]
    shift: Array = rng.normal(0.0, SHIFT, (count, 1, 3)) * chosen[:, None, None]
    turn = from_vectors(rng.normal(0.0, TURN, (count, 3)) * turned[:, None])
    scaled, offset = (torch.from_numpy(values).to(start) for values in (scale * turn, shift))
    start.copy_(start @ scaled.mT + offset)
    return chosen


def _chosen(start: Tensor, points: int, rng: np.random.Generator) -> Indices:
    """[B, points]: those points of each start that are kept; some starts become uneven."""
    count, given = start.shape[:2]
    along = rng.normal(size=(count, 3))
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    slope = rng.uniform(0.0, UNEVEN, count) * (rng.random(count) < UNEVEN_SHARE)
    place = (start.cpu().numpy() @ along[..., None].astype(np.float32))[..., 0]
    # The largest of these are drawn without replacement, with chances that grow along the axis.
    keys = slope[:, None] * place - np.log(-np.log(rng.random((count, given))))
    even = np.arange(given)[None] < points
    keys = np.where(slope[:, None] > 0.0, keys, np.where(even, 1e6, -1e6))
    chosen: Indices = np.argsort(-keys, axis=1, kind="stable")[:, :points]
    if points < given:
        return chosen
    # All points are kept: uneven starts lose half of them, and have others twice.
    half = np.where(np.arange(given) < given // 2, np.arange(given), np.arange(given) - given // 2)
    return np.where((slope > 0.0)[:, None], chosen[:, half], chosen)


def _strew(start: Tensor, counterpart: Tensor, rng: np.random.Generator) -> None:
    """Replace the first points of some starts by random ones: a single one as often as many."""
    count, points = start.shape[:2]
    share = np.exp(rng.uniform(np.log(1.0 / points), np.log(MOST_STREWN), count))
    number = np.ceil(share * points) * (rng.random(count) < STREWN_CHANCE)
    places = STREWN_BOX * (rng.random((count, points, 3)) - 0.5)
    chosen = torch.from_numpy(np.arange(points) < number[:, None])[..., None].to(start.device)
    start.copy_(torch.where(chosen, torch.from_numpy(places).to(start), start))
    counterpart.masked_fill_(chosen, torch.nan)


def _add_plane(start: Tensor, counterpart: Tensor, rng: np.random.Generator) -> tuple[Tensor, Bits]:
    """Put the first points of some starts on a plane at their side; these points, and the starts.

    They stand for a floor or a wall that was scanned with the object.
    """
    count, points = start.shape[:2]
    chosen = rng.random(count) < PLANE_SHARE
    share = rng.uniform(0.05, MOST_ON_PLANE, count)
    axis, end = rng.choice(3, count, p=(0.15, 0.7, 0.15)), rng.choice((-1.0, 1.0), count)
    end = np.where((axis == 1) & (rng.random(count) < 0.8), -1.0, end)  # mostly a floor
    on_plane = (np.arange(points) < (share * points)[:, None]) & chosen[:, None]
    side = rng.uniform(*PLANE_SIDE, (count, 1, 1))
    places = side * (rng.random((count, points, 3)) - 0.5)
    clouds = start.cpu().numpy()
    low, high = clouds.min(1), clouds.max(1)
    bound = np.where(end > 0.0, high[np.arange(count), axis], low[np.arange(count), axis])
    level = bound[:, None] + rng.normal(0.0, 0.004, (count, points))
    places[np.arange(count), :, axis] = level
    foreign = torch.from_numpy(on_plane).to(start.device)
    planes = torch.from_numpy(places).to(start)
    start.copy_(torch.where(foreign[..., None], planes, start))
    counterpart.copy_(torch.where(foreign[..., None], planes, counterpart))
    return foreign.float(), chosen


def mirrored(batch: Batch, chosen: Tensor) -> Batch:
    """The batch with the ``chosen`` rows [B] mirrored, x -> -x in the object and in its views.

    With S = diag(-1, 1, 1) a point S x is seen at S R x, so the rotation becomes S R S.
    """
    sign = torch.where(chosen, -1.0, 1.0)[:, None]
    flip = torch.stack([sign, torch.ones_like(sign), torch.ones_like(sign)], 2)  # [B, 1, 3]

    def flipped(maps: Tensor) -> Tensor:
        return torch.where(chosen[:, None, None, None], maps.flip(-1), maps)

    maps = ("distance", "known", "foreign", "hidden", "depth")
    return replace(
        batch,
        start=batch.start * flip,
        target=batch.target * flip,
        counterpart=batch.counterpart * flip,
        rotation=batch.rotation * flip[:, None] * flip[:, None].mT,
        shift=batch.shift * flip[..., :2],
        **{name: flipped(getattr(batch, name)) for name in maps},
    )
