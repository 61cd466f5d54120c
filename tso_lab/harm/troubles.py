"""What goes wrong in the field: each trouble is what a user did, in three strengths.

Troubles of the mask are in the first view alone, unless they say otherwise; troubles of the camera
and of the depth map are in all views. Nothing else of a scene changes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from scipy.ndimage import distance_transform_edt

from tso_cli.geometry.arrays import Array
from tso_cli.geometry.camera import Camera
from tso_cli.geometry.rotations import from_vectors
from tso_cli.geometry.view import View, object_box

from ..studies.evidence import exact_depth
from .scenes import STARTS, Bits, Rng, Scene

Alter = Callable[[Scene, float, Rng], Scene]
Levels = tuple[float, ...]
Group = Literal["none", "mask", "camera", "depth", "cloud"]
# Of the object's size: half widths of post and foot of a stand, and height of the foot.
POST, FOOT, FOOT_HEIGHT = 0.04, 0.2, 0.06
# Of the width of the object's box: half the width of a shadow, and how far aside it lies at most.
SHADOW, ASIDE = 0.55, 0.2
# A picture of another object overlaps by at most this share of its width.
MOST_OVERLAP = 0.15
LEAST_LEFT = 0.3
"""The share of the foreground that a tight mask keeps, unless it is a pixel thin."""
# The share of the points that must still fall on the mask where the principal point is wrong, and
# the per cent of a picture under which nothing more is tried.
LEAST_ON_MASK, LEAST_CROP = 0.1, 0.5
FLOOR_SHARES = {1.5: 0.2, 2.0: 0.4, 3.0: 0.6}
"""Width of a floor, in widths of the object -> the floor's share of all points."""
FLOATER_BOX = 1.5
"""Side of the box that floaters are strewn in, over the sides of the object's box."""
SHIFT_OF_TURN = 2.0 / 3.0
"""Per cent of the size by which a cloud out of place is shifted, for each degree it is turned."""


@dataclass(frozen=True, eq=False)
class Trouble:
    """One thing that is wrong.

    did : what the user did. alter : (scene, level, rng) -> the altered scene.
    levels : for each strength, in ``unit`` or as a factor; () where it is wrong or not.
    starts : that it is about. views : how many it needs at least.
    """

    name: str
    group: Group
    did: str
    alter: Alter
    levels: Levels = ()
    unit: str = "%"
    starts: tuple[str, ...] = STARTS
    views: int = 1

    def apply(self, scene: Scene, strength: int, rng: Rng) -> Scene:
        """The scene with this trouble; InputError where no mask is left."""
        return self.alter(scene, self.levels[strength] if self.levels else 0.0, rng)

    def at(self, strength: int) -> str:
        """The level in words."""
        return f"{self.levels[strength]:g} {self.unit or 'times'}"


def _sideways(rng: Rng) -> Array:
    """A unit vector [2] of the picture."""
    angle = rng.uniform(0.0, 2.0 * np.pi)
    return np.array([np.cos(angle), np.sin(angle)])


def _size(inside: Bits) -> float:
    """Longest side of the foreground's box, px."""
    left, top, right, bottom = object_box(inside)
    return float(max(right - left, bottom - top))


# Masks: another foreground [H, W] for the one that was given.


def _mask(change: Callable[..., Any], all_views: bool = False) -> Alter:
    def alter(scene: Scene, level: float, rng: Rng) -> Scene:
        count = len(scene.views) if all_views else 1
        changed = (
            replace(view, mask=change(view.inside, level, rng).astype(np.float32))
            for view in scene.views[:count]
        )
        return replace(scene, views=(*changed, *scene.views[count:]))

    return alter


def _arm(inside: Bits, percent: float, rng: Rng) -> Bits:
    row, column = rng.choice(np.argwhere(inside))
    across, down = _sideways(rng)
    rows, columns = np.indices(inside.shape)
    along = (columns - column) * across + (rows - row) * down
    aside = np.abs((columns - column) * down - (rows - row) * across)
    half = max(1.0, percent / 200.0 * _size(inside))
    limb: Bits = inside | ((along >= 0.0) & (aside <= half))
    return limb


def _stand(inside: Bits, percent: float, rng: Rng) -> Bits:
    size, places = _size(inside), np.argwhere(inside)
    middle = places[np.argsort(places[:, 1], kind="stable")[len(places) // 2], 1]
    lowest, joint = places[:, 0].max(), places[places[:, 1] == middle, 0].max()
    rows, columns = np.indices(inside.shape)
    end, aside = lowest + percent / 100.0 * size, np.abs(columns - middle)
    post = (rows >= joint) & (rows <= end) & (aside <= max(1.0, POST * size))
    foot = (rows > end - FOOT_HEIGHT * size) & (rows <= end) & (aside <= FOOT * size)
    joined: Bits = inside | post | foot
    return joined


def _shadow(inside: Bits, percent: float, rng: Rng) -> Bits:
    left, _, right, bottom = object_box(inside)
    width = right - left
    middle = (left + right - 1) / 2.0 + ASIDE * width * rng.uniform(-1.0, 1.0)
    height = max(1.0, percent / 100.0 * _size(inside))
    rows, columns = np.indices(inside.shape)
    away = ((columns - middle) / (SHADOW * width)) ** 2 + ((rows - bottom + 1) / height) ** 2
    shaded: Bits = inside | (away <= 1.0)
    return shaded


def _other_object(scene: Scene, _: float, rng: Rng) -> Scene:
    inside = scene.views[0].inside
    other = _neighbour(scene, 1.0)
    left, top, right, bottom = object_box(inside)
    corner = (top + bottom - other.shape[0]) // 2, (left + right - other.shape[1]) // 2
    placed = _pasted(other, *corner, inside)
    return _mask(lambda *_: placed)(scene, 0.0, rng)


def _neighbour(scene: Scene, size: float) -> Bits:
    """The silhouette of another object, cut out; its ``size`` is in sizes of the object."""
    other = scene.beside()
    left, top, right, bottom = object_box(other)
    other = other[top:bottom, left:right]
    scale = size * _size(scene.views[0].inside) / max(other.shape)
    lengths = [max(2, round(scale * length)) for length in other.shape]
    picked = [np.arange(n) * length // n for n, length in zip(lengths, other.shape, strict=True)]
    return other[np.ix_(*picked)]


def _second_object(scene: Scene, percent: float, rng: Rng) -> Scene:
    inside, other = scene.views[0].inside, _neighbour(scene, percent / 100.0)
    left, _, right, bottom = object_box(inside)
    side = int(rng.integers(2))
    near = distance_transform_edt(~inside) <= 1.5
    first = round(MOST_OVERLAP * rng.uniform() * other.shape[1])
    # It moves nearer until the two touch.
    for overlap in range(first, right - left + other.shape[1]):
        edge = right - overlap if side else left - other.shape[1] + overlap
        placed = _pasted(other, bottom - other.shape[0], edge, inside)
        if (placed & near).any():
            break
    return _mask(lambda *_: inside | placed)(scene, percent, rng)


def _pasted(small: Bits, top: int, left: int, picture: Bits) -> Bits:
    """An empty picture of that size with ``small`` at a place that may reach beyond it."""
    rows, columns = np.nonzero(small)
    rows, columns = rows + top, columns + left
    height, width = picture.shape
    seen = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
    placed = np.zeros_like(picture)
    placed[rows[seen], columns[seen]] = True
    return placed


def _bite(inside: Bits, percent: float, rng: Rng) -> Bits:
    along = np.tensordot(_sideways(rng), np.indices(inside.shape), 1)
    left: Bits = inside & (along > np.quantile(along[inside], percent / 100.0))
    return left


def _pixels(inside: Bits, percent: float) -> int:
    return max(1, round(percent / 100.0 * _size(inside)))


def _grown(inside: Bits, percent: float, rng: Rng) -> Bits:
    grown: Bits = distance_transform_edt(~inside) <= _pixels(inside, percent)
    return grown


def _shrunk(inside: Bits, percent: float, rng: Rng) -> Bits:
    """By less where hardly anything would be left."""
    depth = distance_transform_edt(inside)
    most = np.quantile(depth[inside], 1.0 - LEAST_LEFT)
    left: Bits = depth > min(_pixels(inside, percent), most)
    return left


# Cameras: what changes in the cameras of all views, by the same sign.


def _camera(change: Callable[[Camera, float, float], dict[str, Any]]) -> Alter:
    def alter(scene: Scene, level: float, rng: Rng) -> Scene:
        sign = float(rng.choice([-1.0, 1.0]))
        return _with_cameras(scene, lambda camera: replace(camera, **change(camera, level, sign)))

    return alter


def _with_cameras(scene: Scene, change: Callable[[Camera], Camera]) -> Scene:
    views = (replace(view, camera=change(view.camera)) for view in scene.views)
    return replace(scene, views=tuple(views))


def _focal(camera: Camera, factor: float, sign: float) -> dict[str, Any]:
    return {"K": camera.K @ np.diag([factor**sign, factor**sign, 1.0])}


def _squashed(camera: Camera, percent: float, sign: float) -> dict[str, Any]:
    return {"K": camera.K @ np.diag([1.0, (1.0 + percent / 100.0) ** sign, 1.0])}


def _yaw(camera: Camera, degrees: float, sign: float) -> dict[str, Any]:
    return {"R": camera.R @ from_vectors(sign * np.radians(degrees) * np.eye(3)[1])}


def _rolled(camera: Camera, degrees: float, sign: float) -> dict[str, Any]:
    turn = from_vectors(sign * np.radians(degrees) * np.eye(3)[2])
    return {"R": turn @ camera.R, "t": turn @ camera.t}


def _crop(scene: Scene, percent: float, rng: Rng) -> Scene:
    """The principal point is off, by less where the cloud would miss a mask."""
    direction = _sideways(rng)
    while True:
        share = percent / 100.0

        def moved(camera: Camera, share: float = share) -> Camera:
            pixels = share * max(camera.width, camera.height) * direction
            return replace(camera, K=camera.K + np.outer([*pixels, 0.0], [0.0, 0.0, 1.0]))

        cropped = _with_cameras(scene, moved)
        on_mask = min(_on_mask(scene.initial, view) for view in cropped.views)
        # Of a thin object few points fall on a mask of few pixels, however little is cropped.
        if on_mask >= LEAST_ON_MASK or percent < LEAST_CROP:
            return cropped
        percent /= 2.0


def _on_mask(points: Array, view: View) -> float:
    """The share of ``points`` [N, 3] that fall on the mask."""
    columns, rows = np.rint(view.camera.project(points)[0]).astype(int).T
    height, width = view.mask.shape
    seen = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
    return float(view.inside[rows[seen], columns[seen]].sum() / len(points))


def _portrait(scene: Scene, level: float, rng: Rng) -> Scene:
    """Of a picture of 3:4, the principal point's coordinates are exchanged."""
    views = []
    for view in scene.views:
        more = round(view.camera.width / 6)
        K = view.camera.K.copy()
        K[:2, 2] = K[1, 2] + more, K[0, 2]
        mask = np.pad(view.mask, ((more, more), (0, 0)))
        camera = replace(view.camera, K=K, height=mask.shape[0])
        views.append(replace(view, mask=mask, camera=camera))
    return replace(scene, views=tuple(views))


def _other_camera(scene: Scene, level: float, rng: Rng) -> Scene:
    first, second, third, fourth = scene.views
    return replace(scene, views=(first, replace(second, camera=third.camera), third, fourth))


# Depth maps [H, W] of the true surface, NaN beside it, altered; the longest side is 1.


def _depth(change: Callable[[Array, View, float, Rng], Array]) -> Alter:
    def alter(scene: Scene, level: float, rng: Rng) -> Scene:
        views = []
        for view in scene.views:
            exact = exact_depth(scene.world, view.camera)
            exact = np.where(np.isfinite(exact), exact, np.nan)
            views.append(replace(view, depth=change(exact, view, level, rng)))
        return replace(scene, views=tuple(views))

    return alter


def _depth_right(depth: Array, view: View, level: float, rng: Rng) -> Array:
    return depth


def _depth_far(depth: Array, view: View, percent: float, rng: Rng) -> Array:
    return depth * (1.0 + percent / 100.0)


def _depth_offset(depth: Array, view: View, percent: float, rng: Rng) -> Array:
    shift = np.rint(_pixels(view.inside, percent) * _sideways(rng)).astype(int)
    return np.roll(depth, shift.tolist(), (0, 1))


def _depth_noise(depth: Array, view: View, percent: float, rng: Rng) -> Array:
    return depth + percent / 100.0 * rng.normal(size=depth.shape)


def _depth_relief(depth: Array, view: View, factor: float, rng: Rng) -> Array:
    middle = np.nanmedian(depth)
    return np.asarray(middle + factor * (depth - middle))


# Clouds: another start; added points follow those of the object.


def _cloud(change: Callable[[Array, float, Rng], Array]) -> Alter:
    def alter(scene: Scene, level: float, rng: Rng) -> Scene:
        return replace(scene, initial=change(scene.initial, level, rng))

    return alter


def _middle(points: Array) -> Array:
    """[3], of the bounding box."""
    return np.asarray((points.min(0) + points.max(0)) / 2.0)


def _count(points: Array, share: float) -> int:
    """How many added points have this share of all points."""
    return max(1, round(share / (1.0 - share) * len(points)))


def _floor(points: Array, times: float, rng: Rng) -> Array:
    width = times * np.ptp(points, axis=0)[[0, 2]].max()
    places = rng.uniform(-0.5, 0.5, (_count(points, FLOOR_SHARES[times]), 3))
    floor = _middle(points) + width * places
    floor[:, 1] = points[:, 1].min()
    return np.concatenate([points, floor])


def _floaters(points: Array, percent: float, rng: Rng) -> Array:
    places = rng.uniform(-0.5, 0.5, (_count(points, percent / 100.0), 3))
    strewn = _middle(points) + FLOATER_BOX * np.ptp(points, axis=0) * places
    return np.concatenate([points, strewn])


def _flipped(*signs: float) -> Alter:
    """About the middle of the cloud."""
    return _cloud(lambda points, *_: _middle(points) + (points - _middle(points)) * signs)


def _out_of_place(points: Array, degrees: float, rng: Rng) -> Array:
    axis, direction = (vector / np.linalg.norm(vector) for vector in rng.normal(size=(2, 3)))
    turn, middle = from_vectors(np.radians(degrees) * axis), _middle(points)
    shift = SHIFT_OF_TURN * degrees / 100.0 * direction
    return np.asarray((points - middle) @ turn.T + middle + shift)


def _too_large(points: Array, times: float, rng: Rng) -> Array:
    middle = _middle(points)
    return np.asarray(middle + times * (points - middle))


DEGREES = "degrees"
TROUBLES = (
    Trouble("nothing wrong", "none", "nothing", lambda scene, *_: scene),
    Trouble("arm", "mask", "masked the arm that holds it", _mask(_arm), (6, 10, 15)),
    Trouble("stand", "mask", "masked its stand too", _mask(_stand), (10, 20, 35)),
    Trouble("shadow", "mask", "masked its contact shadow", _mask(_shadow), (6, 10, 15)),
    Trouble("second object", "mask", "masked its neighbour too", _second_object, (35, 60, 100)),
    Trouble("other object", "mask", "masked its neighbour instead", _other_object),
    Trouble("bite", "mask", "let something hide a part", _mask(_bite), (8, 15, 30)),
    Trouble("grown", "mask", "took loose masks", _mask(_grown, True), (1, 2, 4)),
    Trouble("shrunk", "mask", "took tight masks", _mask(_shrunk, True), (1, 2, 4)),
    Trouble("focal", "camera", "guessed the focal length", _camera(_focal), (0.9, 0.85, 0.8), ""),
    Trouble("squashed", "camera", "changed the aspect ratio", _camera(_squashed), (6, 10, 15)),
    Trouble("crop", "camera", "kept K of the picture before it was cropped", _crop, (5, 10, 20)),
    Trouble("portrait", "camera", "exchanged width and height for K", _portrait),
    Trouble("yaw", "camera", "took masks of the next frame", _camera(_yaw), (3, 6, 12), DEGREES),
    Trouble("far yaw", "camera", "mixed up pictures", _camera(_yaw), (25, 45, 70), DEGREES),
    Trouble("other camera", "camera", "gave two views one camera", _other_camera, views=4),
    Trouble("rolled", "camera", "left out the roll", _camera(_rolled), (2, 5, 10), DEGREES),
    Trouble("depth right", "depth", "gave right maps, nothing is wrong", _depth(_depth_right)),
    Trouble("depth far", "depth", "gave maps of a wrong scale", _depth(_depth_far), (5, 10, 20)),
    Trouble("depth offset", "depth", "did not register them", _depth(_depth_offset), (1, 3, 6)),
    Trouble("depth noise", "depth", "gave noisy maps", _depth(_depth_noise), (1, 3, 6)),
    Trouble("depth relief", "depth", "gave guessed maps", _depth(_depth_relief), (1.3, 1.6, 2), ""),
    Trouble("floor", "cloud", "left the floor in", _cloud(_floor), tuple(FLOOR_SHARES), ""),
    Trouble("floaters", "cloud", "left floaters in", _cloud(_floaters), (2, 5, 10)),
    Trouble("mirrored", "cloud", "mirrored x", _flipped(-1, 1, 1), starts=STARTS[:1]),
    Trouble("backwards", "cloud", "turned it half a turn", _flipped(-1, 1, -1)),
    Trouble(
        "out of place", "cloud", "placed it roughly", _cloud(_out_of_place), (3, 6, 12), DEGREES
    ),
    Trouble("too large", "cloud", "guessed its size", _cloud(_too_large), (1.05, 1.1, 1.2), ""),
)
TROUBLE = {trouble.name: trouble for trouble in TROUBLES}
