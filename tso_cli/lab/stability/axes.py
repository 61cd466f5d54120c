"""The axes of stability: what can be wrong with the input of a refinement, each from harmless to hopeless.

Every function alters a `Case` by one level. Random numbers only choose directions and places, so that one seed gives all levels
of an axis the same ones. What no `View` or `Camera` accepts raises InputError.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, gaussian_filter, shift

from ...geometry.camera import Array, Camera
from ...geometry.points import farthest_point_sample
from ...geometry.resampling import Box, area_resize
from ...geometry.rotations import from_vectors
from ...geometry.view import View, object_box
from ...optimisation.presets import PAPER_GAMMA, PAPER_SIGMA_SQ
from ...refinement.config import RefineConfig
from ..studies.cases import Case

Rng = np.random.Generator
Bits = NDArray[np.bool_]
Alter = Callable[[Case, float, Rng], Case]
Group = Literal["settings", "mask", "camera", "cloud", "image"]

# How many times as thin the thin object of a pair is, and bars across an object that is full of holes.
THIN, BARS = 8.0, 8
# Of the object's size: the radius of a hole in its mask, the blur before a wrong threshold, the jitter of repeated points.
HOLE, BLUR, JITTER = 0.04, 0.03, 0.005
# Half the box that outliers are in; the object's longest side is 1.
SPREAD, SPREAD_CLOSE = 2.5, 0.5
# How far off a clump of outliers is, and its standard deviation.
CLUMP, CLUMP_SIZE = 3.0, 0.02
# How many times as wide as the object the floor under it is.
FLOOR = 2.0


@dataclass(frozen=True, eq=False)
class Axis:
    """One thing that is wrong, and how wrong.

    Parameters
    ----------
    group : what of the input is wrong. name, unit : in plain words. levels : from harmless to hopeless, in ``unit``; a single
        one where it is wrong or not.
    alter : (case, level, rng) -> the altered case, with target and dense as they were unless the object itself, or the frame
        of the cloud, is another; in group "settings" (config, level) -> the altered `RefineConfig`; where ``needs_other``
        (case, level, rng, another case) -> the altered case.
    mistakes : of a gross mistake of the user, which no result makes good, the name in `ASSUMPTIONS` at each level.
    adds_points : the altered start begins with the points of the case, and added ones follow.
    masks : how many of the case's views the refinement sees. Masks are wrong in the first alone, cameras in all of them.
    """

    group: Group
    name: str
    unit: str
    levels: tuple[float, ...]
    alter: Callable[..., Any]
    mistakes: tuple[str, ...] = ()
    adds_points: bool = False
    needs_other: bool = False
    masks: int = 1

    def apply(
        self,
        case: Case,
        level: float,
        rng: Rng,
        other: Case | None = None,
        config: RefineConfig | None = None,
    ) -> tuple[Case, RefineConfig]:
        """The case to refine at ``level``, and the settings to refine it with; raises InputError where it cannot be made."""
        config = config or RefineConfig()
        if self.group == "settings":
            return case, self.alter(config, level)
        return self.alter(case, level, rng, *([other] if self.needs_other else [])), config

    @property
    def gross(self) -> bool:
        return bool(self.mistakes)

    def mistake(self, level: float) -> str:
        """Its name, "" where it is none."""
        return self.mistakes[self.levels.index(level)] if self.mistakes else ""

    def at(self, level: float) -> str:
        """The level in words; none where it is wrong or not."""
        return f"{level:g} {self.unit}".strip() if len(self.levels) > 1 or self.unit else ""

    def own(self, case: Case, points: Array) -> Array:
        """Of a result's points [M, 3] those that were in the start of ``case``, without added ones."""
        return points[: len(case.initial)] if self.adds_points else points


def _first(case: Case, view: View) -> Case:
    return replace(case, views=(view, *case.views[1:]))


def _aside(rng: Rng) -> Array:
    """A unit vector of the image plane [3]."""
    angle = rng.uniform(0.0, 2.0 * np.pi)
    return np.array([np.cos(angle), np.sin(angle), 0.0])


def _direction(rng: Rng) -> Array:
    direction = rng.normal(size=3)
    unit: Array = direction / np.linalg.norm(direction)
    return unit


# Masks: another one [H, W] for what is foreground [H, W] in the first view.


def _mask(
    name: str,
    unit: str,
    levels: tuple[float, ...],
    change: Callable[[Bits, float, Rng], Any],
    **options: Any,
) -> Axis:
    def alter(case: Case, level: float, rng: Rng) -> Case:
        view = case.views[0]
        return _first(
            case, replace(view, mask=change(view.mask > 0.5, level, rng).astype(np.float32))
        )

    return Axis("mask", name, unit, levels, alter, **options)


def _size(inside: Bits) -> float:
    """Longest side of the foreground's box, px."""
    return float(max(np.ptp(places) + 1 for places in np.nonzero(inside)))


def _least(inside: Bits, order: Array, percent: float) -> Bits:
    """Those pixels of ``inside`` where ``order`` is least."""
    return inside & (order <= np.quantile(order[inside], percent / 100.0))


def _edge_moved(inside: Bits, percent: float, rng: Rng, outward: float) -> Bits:
    beyond = distance_transform_edt(~inside) - distance_transform_edt(inside)
    moved: Bits = beyond - 0.5 * np.sign(beyond) <= outward * percent / 100.0 * _size(inside)
    return moved


def _with_holes(inside: Bits, percent: float, rng: Rng) -> Bits:
    rows, columns = np.indices(inside.shape)
    left, squared = inside.copy(), max(1.0, HOLE * _size(inside)) ** 2
    for row, column in rng.permutation(np.argwhere(inside)):
        if left.sum() <= (1.0 - percent / 100.0) * inside.sum():
            break
        left &= (rows - row) ** 2 + (columns - column) ** 2 > squared
    return left


def _thresholded(inside: Bits, threshold: float, rng: Rng) -> Any:
    return gaussian_filter(inside.astype(float), BLUR * _size(inside)) > threshold


def _occluded(inside: Bits, percent: float, rng: Rng) -> Bits:
    return _least(
        inside, np.tensordot(_aside(rng)[:2], np.indices(inside.shape), 1), 100.0 - percent
    )


def _shifted(inside: Bits, percent: float, rng: Rng) -> Any:
    return shift(
        inside.astype(np.uint8), np.rint(percent / 100.0 * _size(inside) * _aside(rng)[:2]), order=0
    )


def _nearly_empty(inside: Bits, percent: float, rng: Rng) -> Bits:
    """The pixels nearest to one of them."""
    place = rng.choice(np.argwhere(inside))
    return _least(
        inside, np.square(np.indices(inside.shape) - place[:, None, None]).sum(0), percent
    )


def _nearly_full(inside: Bits, percent: float, rng: Rng) -> Bits:
    return inside | _least(~inside, distance_transform_edt(~inside), percent)


def _cut(case: Case, percent: float, rng: Rng) -> Case:
    """The picture ends within the object, on one of its four sides; the camera is right."""
    view, side = case.views[0], int(rng.integers(4))
    ends = np.array([(0, 0), view.mask.shape])
    share = percent / 100.0 if side < 2 else 1.0 - percent / 100.0
    ends[side // 2, side % 2] = (
        np.quantile(np.nonzero(view.mask > 0.5)[side % 2], share) + side // 2
    )
    (top, left), (bottom, right) = ends.tolist()
    camera = view.camera.cropped(
        (left - 0.5, top - 0.5, right - 0.5, bottom - 0.5), right - left, bottom - top
    )
    return _first(case, replace(view, mask=view.mask[top:bottom, left:right], camera=camera))


def _boxed(inside: Bits, level: float, rng: Rng) -> Bits:
    """A detector's bounding box."""
    left, top, right, bottom = object_box(inside)
    boxed = np.zeros_like(inside)
    boxed[top:bottom, left:right] = True
    return boxed


def _of_other(case: Case, level: float, rng: Rng, other: Case) -> Case:
    view = case.views[0]
    return _first(
        case,
        replace(view, mask=_resized(other.views[0].mask, view.camera.width, view.camera.height)),
    )


def _masks_exchanged(case: Case, level: float, rng: Rng) -> Case:
    first, second, *others = case.views
    return replace(
        case, views=(replace(first, mask=second.mask), replace(second, mask=first.mask), *others)
    )


# Cameras: what changes in those of all views.

Fields = Callable[[Camera, float, Rng], dict[str, Any]]


def _camera(
    name: str, unit: str, levels: tuple[float, ...], change: Fields, **options: Any
) -> Axis:
    return Axis("camera", name, unit, levels, _seen(change), **options)


def _seen(change: Fields) -> Alter:
    def alter(case: Case, level: float, rng: Rng) -> Case:
        views = (
            replace(view, camera=replace(view.camera, **change(view.camera, level, rng)))
            for view in case.views
        )
        return replace(case, views=tuple(views))

    return alter


def _around_object(camera: Camera, degrees: float, rng: Rng, axis: int) -> dict[str, Any]:
    """Turned about the vertical axis of the world (1), or an axis of the camera (0, 2), through the object's middle."""
    turn = from_vectors(np.radians(degrees) * rng.choice([-1.0, 1.0]) * np.eye(3)[axis])
    return {"R": camera.R @ turn if axis == 1 else turn @ camera.R}


def _around_itself(camera: Camera, degrees: float, rng: Rng) -> dict[str, Any]:
    turn = from_vectors(np.radians(degrees) * _aside(rng))
    return {"R": turn @ camera.R, "t": turn @ camera.t}


def _scaled(
    camera: Camera, factor: float, rng: Rng, focal: bool = False, distance: bool = False
) -> dict[str, Any]:
    """Focal length, distance or both, too long or too short."""
    factor **= float(rng.choice([-1.0, 1.0]))
    f, z = factor if focal else 1.0, factor if distance else 1.0
    return {"K": camera.K @ np.diag([f, f, 1.0]), "t": camera.t * [1.0, 1.0, z]}


def _in_axes(*signs: float) -> Fields:
    return lambda camera, level, rng: {"R": np.diag(signs) @ camera.R, "t": camera.t * signs}


def _principal_point(camera: Camera, percent: float, rng: Rng) -> dict[str, Any]:
    return {
        "K": camera.K
        + percent
        / 100.0
        * max(camera.width, camera.height)
        * np.outer(_aside(rng), [0.0, 0.0, 1.0])
    }


def _exchanged(case: Case, level: float, rng: Rng) -> Case:
    """Of pictures a half wider than the case's: of a square one the two numbers are the same."""
    views = []
    for view in case.views:
        width, height, more = view.camera.width, view.camera.height, view.camera.width // 2
        camera = view.camera.cropped(
            (-0.5 - more, -0.5, width - 0.5, height - 0.5), width + more, height
        )
        K = camera.K.copy()
        K[:2, 2] = K[1::-1, 2]
        views.append(
            replace(view, mask=np.pad(view.mask, ((0, 0), (more, 0))), camera=replace(camera, K=K))
        )
    return replace(case, views=tuple(views))


# Clouds: another start [N, 3], or the whole cloud in another frame.


def _start(
    name: str,
    unit: str,
    levels: tuple[float, ...],
    change: Callable[[Case, float, Rng], Array],
    **options: Any,
) -> Axis:
    alter = lambda case, level, rng: replace(case, initial=change(case, level, rng))  # noqa: E731
    return Axis("cloud", name, unit, levels, alter, **options)


def _clouds(case: Case, change: Callable[[Array], Array]) -> Case:
    return replace(
        case, initial=change(case.initial), target=change(case.target), dense=change(case.dense)
    )


def _framed(matrix: Any, power: float = 1.0) -> Alter:
    """The cloud, and so the result, is in other axes than the camera: ``matrix`` times the level to a power."""
    return lambda case, level, rng: _clouds(
        case, lambda points: level**power * points @ np.array(matrix, float).T
    )


def _behind(case: Case, percent: float, rng: Rng) -> Array:
    """Nearer to the camera, until so many points are behind it."""
    camera = case.views[0].camera
    depth = case.initial @ camera.R[2] + camera.t[2]
    return case.initial - (np.quantile(depth, percent / 100.0) + 1e-3) * camera.R[2]


def _flat(case: Case, percent: float, rng: Rng) -> Array:
    """Along the line of sight."""
    forward = case.views[0].camera.R[2]
    return case.initial - percent / 100.0 * np.outer(
        (case.initial - case.initial.mean(0)) @ forward, forward
    )


def _collinear(case: Case, percent: float, rng: Rng) -> Array:
    """Towards its longest axis."""
    middle = case.initial.mean(0)
    along = np.linalg.svd(case.initial - middle, full_matrices=False)[2][0]
    line = middle + np.outer((case.initial - middle) @ along, along)
    return line + (1.0 - percent / 100.0) * (case.initial - line)


def _shrunk(case: Case, factor: float, rng: Rng) -> Array:
    middle = case.initial.mean(0)
    return middle + (case.initial - middle) / factor


def _added(case: Case, more: Array) -> Array:
    return np.concatenate([case.initial, more])


def _share(case: Case, percent: float) -> int:
    """So much of the cloud's points, at least one."""
    return max(1, round(percent / 100.0 * len(case.initial)))


def _with_outliers(case: Case, percent: float, rng: Rng, spread: float = SPREAD) -> Array:
    return _added(case, rng.uniform(-spread, spread, (_share(case, percent), 3)))


def _with_clump(case: Case, percent: float, rng: Rng) -> Array:
    return _added(
        case, CLUMP * _direction(rng) + CLUMP_SIZE * rng.normal(size=(_share(case, percent), 3))
    )


def _with_floor(case: Case, percent: float, rng: Rng) -> Array:
    """A ground plane, as in a scan of which the object was not cut out; y is up."""
    low, high = case.initial.min(0), case.initial.max(0)
    middle, width = (low + high) / 2.0, FLOOR * max(high[0] - low[0], high[2] - low[2])
    floor = middle + width * rng.uniform(-0.5, 0.5, (_share(case, percent), 3))
    floor[:, 1] = low[1]
    return _added(case, floor)


def _with_duplicates(case: Case, percent: float, rng: Rng) -> Array:
    """Of points in one half of the cloud."""
    half = np.argsort(case.initial @ _direction(rng))[: -(-len(case.initial) // 2)]
    return _added(case, case.initial[rng.choice(half, _share(case, percent))])


def _counted(case: Case, count: float, rng: Rng) -> Array:
    if count <= len(case.initial):
        return case.initial[farthest_point_sample(case.initial, int(count))]
    repeated = case.initial[rng.integers(len(case.initial), size=int(count) - len(case.initial))]
    return _added(case, repeated + JITTER * rng.normal(size=repeated.shape))


def _uneven(case: Case, factor: float, rng: Rng) -> Array:
    """As many points, so many times as dense at one end as at the other."""
    along = case.initial @ _direction(rng)
    share = factor ** ((along - along.min()) / np.ptp(along))
    drawn = rng.choice(len(along), len(along), p=share / share.sum())
    return case.initial[drawn] + JITTER * rng.normal(size=case.initial.shape)


# Objects and pictures.


def _thin(case: Case, factor: float, rng: Rng) -> Case:
    """So many times as thin across the first picture, whose mask is exact; other views are left out."""
    view, camera = case.views[0], case.views[0].camera
    middle, (left, right) = camera.K[0, 2], np.array([-0.5, camera.width - 0.5])
    box = (
        middle + factor * (left - middle),
        -0.5,
        middle + factor * (right - middle),
        camera.height - 0.5,
    )
    thin = replace(
        case, views=(replace(view, mask=_cells(view.mask, box, camera.width, camera.height)),)
    )
    return _clouds(
        thin,
        lambda p: p - (1.0 - 1.0 / factor) * np.outer(p @ camera.R[0] + camera.t[0], camera.R[0]),
    )


def _holed(case: Case, percent: float, rng: Rng) -> Case:
    """Of the object only bars are left, along the first picture's lines of sight; other views are left out."""
    view, phase = case.views[0], rng.random()
    pitch = _size(view.mask > 0.5) * np.sqrt(2.0) / BARS

    def kept(columns_and_rows: Array) -> Bits:
        bars: Bits = (columns_and_rows.sum(0) / pitch + phase) % 1.0 >= percent / 100.0
        return bars

    dense = case.dense[kept(view.camera.project(case.dense)[0].T)]
    target = dense[farthest_point_sample(dense, min(len(case.target), len(dense)))]
    mask = view.mask * kept(np.indices(view.mask.shape).astype(float))
    return replace(case, views=(replace(view, mask=mask),), dense=dense, target=target)


def _one_turned(case: Case, degrees: float, rng: Rng) -> Case:
    return _first(case, _seen(_YAW)(case, degrees, rng).views[0])


def _of_thin(change: Fields) -> Alter:
    return lambda case, level, rng: _seen(change)(_thin(case, THIN, rng), level, rng)


def _small(case: Case, percent: float, rng: Rng) -> Case:
    """The object is so large in a picture of the same size."""
    views = []
    for view in case.views:
        width, height = view.camera.width, view.camera.height
        more = (100.0 * _size(view.mask > 0.5) / (percent * max(width, height)) - 1.0) / 2.0
        box = (
            -more * width - 0.5,
            -more * height - 0.5,
            (1.0 + more) * width - 0.5,
            (1.0 + more) * height - 0.5,
        )
        views.append(
            replace(
                view,
                mask=_cells(view.mask, box, width, height),
                camera=view.camera.cropped(box, width, height),
            )
        )
    return replace(case, views=tuple(views))


def _pictured(case: Case, pixels: float, rng: Rng) -> Case:
    views = []
    for view in case.views:
        sizes = view.camera.width, view.camera.height
        width, height = (max(1, round(pixels / max(sizes) * size)) for size in sizes)
        views.append(
            replace(
                view,
                mask=_resized(view.mask, width, height),
                camera=view.camera.resized(width, height),
            )
        )
    return replace(case, views=tuple(views))


def _resized(mask: NDArray[np.float32], width: int, height: int) -> NDArray[np.float32]:
    rows, columns = mask.shape
    if width <= columns and height <= rows:
        return _cells(mask, (-0.5, -0.5, columns - 0.5, rows - 0.5), width, height)
    # Enlarged pixels stay squares; a picture of 8,192 pixels each way fills half a GiB in float64.
    return mask[(np.arange(height) * rows // height)[:, None], np.arange(width) * columns // width]


def _cells(mask: NDArray[np.float32], box: Box, width: int, height: int) -> NDArray[np.float32]:
    """Background beyond the picture."""
    means, covered = area_resize(mask, box, width, height)
    return np.clip(means * covered, 0.0, 1.0).astype(np.float32)


# Settings.


def _settings(
    name: str,
    unit: str,
    levels: tuple[float, ...],
    change: Callable[[RefineConfig, float], dict[str, Any]],
) -> Axis:
    alter = lambda config, level: replace(config, **change(config, level))  # noqa: E731
    return Axis("settings", name, unit, levels, alter)


def _paper(name: str, value: float) -> Callable[[RefineConfig, float], dict[str, Any]]:
    return lambda config, factor: {"preset": "paper", name: factor * value}


def _rate(config: RefineConfig, factor: float) -> dict[str, Any]:
    return {"learning_rate": factor * config.settings().learning_rate}


def _steps(config: RefineConfig, steps: float) -> dict[str, Any]:
    return {"steps": int(steps)}


_SIGMA, _GAMMA = _paper("sigma_sq", PAPER_SIGMA_SQ), _paper("gamma", PAPER_GAMMA["points"])
_UP, _DOWN = (2.0, 5.0, 10.0, 100.0, 1000.0), (0.5, 0.2, 0.1, 0.01, 0.001)
_SHARES, _GONE = (2.0, 5.0, 10.0, 20.0, 40.0, 80.0), (10.0, 20.0, 50.0, 80.0, 99.0, 100.0)
_DEGREES = (1.0, 2.0, 5.0, 10.0, 20.0, 45.0, 90.0)
_FACTORS = (1.01, 1.02, 1.05, 1.1, 1.25, 2.0, 5.0)
_STRAYS = (0.1, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0)
_UNITS = (2.0, 10.0, 39.37, 100.0, 1000.0)
_TOO_LARGE = (
    "cloud-twice-large",
    "cloud-ten-times-large",
    "cloud-inches",
    "cloud-centimetres",
    "cloud-millimetres",
)
_TOO_SMALL = (
    "cloud-half-large",
    "cloud-ten-times-small",
    "camera-inches",
    "camera-centimetres",
    "camera-millimetres",
)
_SIZES, _SIZE, _TIMES, _YES = (
    (1.0, 2.0, 5.0, 10.0, 20.0, 50.0),
    "% of the object's size",
    "times",
    (1.0,),
)
_YAW: Fields = partial(_around_object, axis=1)
_ASIDE: Fields = lambda camera, percent, rng: {"t": camera.t + percent / 100.0 * _aside(rng)}  # noqa: E731
_FOR_SIZE: Fields = lambda camera, factor, rng: {"K": np.diag([factor, factor, 1.0]) @ camera.K}  # noqa: E731
_TO_WORLD: Fields = lambda camera, level, rng: {"R": camera.R.T, "t": camera.position}  # noqa: E731
_is: Callable[[str], Any] = lambda mistake: {"mistakes": (mistake,)}  # noqa: E731
_DILATED = partial(_edge_moved, outward=1.0)

AXES: tuple[Axis, ...] = (
    _settings("nothing wrong", "", _YES, lambda config, level: {}),
    _mask("mask dilated", _SIZE, _SIZES, _DILATED),
    _mask(
        "mask eroded", _SIZE, (0.5, 1.0, 2.0, 4.0, 8.0, 16.0), partial(_edge_moved, outward=-1.0)
    ),
    _mask("holes in the mask", "% of its area", _SHARES, _with_holes),
    _mask(
        "speckle",
        "% of the pixels",
        (0.1, 0.5, 2.0, 5.0, 15.0, 45.0),
        lambda m, p, rng: m ^ (rng.random(m.shape) < p / 100.0),
    ),
    _mask("threshold too high, 0.5 is right", "", (0.5, 0.6, 0.7, 0.8, 0.9, 0.98), _thresholded),
    _mask("threshold too low, 0.5 is right", "", (0.5, 0.4, 0.3, 0.2, 0.1, 0.01), _thresholded),
    _mask("mask occluded", "% of its area", _SHARES, _occluded),
    Axis("mask", "object cut by the border", "% of its area", _SHARES, _cut),
    _mask("mask shifted", _SIZE, _SIZES, _shifted),
    _mask(
        "mask flipped left to right",
        "",
        _YES,
        lambda m, level, rng: m[:, ::-1],
        **_is("mask-flipped"),
    ),
    _mask("mask upside down", "", _YES, lambda m, level, rng: m[::-1], **_is("mask-upside-down")),
    _mask("mask inverted", "", _YES, lambda m, level, rng: ~m, **_is("mask-inverted")),
    Axis("mask", "mask of another object", "", _YES, _of_other, needs_other=True),
    _mask("box in place of the mask", "", _YES, _boxed),
    _mask("mask nearly empty", "% of it left", (80.0, 50.0, 20.0, 5.0, 1.0, 0.01), _nearly_empty),
    _mask(
        "mask nearly full",
        "% of the rest filled",
        (2.0, 5.0, 20.0, 50.0, 90.0, 99.0, 100.0),
        _nearly_full,
    ),
    _mask("mask shifted, beside a right one", _SIZE, _SIZES, _shifted, masks=2),
    _mask("mask dilated, beside a right one", _SIZE, _SIZES, _DILATED, masks=2),
    Axis("mask", "two masks exchanged", "", _YES, _masks_exchanged, masks=2),
    Axis(
        "mask",
        "mask of another object, beside a right one",
        "",
        _YES,
        _of_other,
        needs_other=True,
        masks=2,
    ),
    Axis(
        "mask",
        "mask of another object, beside three right ones",
        "",
        _YES,
        _of_other,
        needs_other=True,
        masks=4,
    ),
    _camera("yaw of the camera", "degrees", (*_DEGREES, 180.0), _YAW),
    _camera("pitch of the camera", "degrees", (*_DEGREES, 180.0), partial(_around_object, axis=0)),
    _camera("roll of the camera", "degrees", (*_DEGREES, 180.0), partial(_around_object, axis=2)),
    _camera(
        "camera turned where it stands", "degrees", (0.2, 0.5, 1.0, 2.0, 5.0, 20.0), _around_itself
    ),
    _camera("camera moved aside", _SIZE, _SIZES, _ASIDE),
    _camera("distance of the camera", _TIMES, _FACTORS, partial(_scaled, distance=True)),
    _camera("focal length", _TIMES, _FACTORS, partial(_scaled, focal=True)),
    _camera(
        "focal length and distance",
        _TIMES,
        (1.1, 1.25, 1.5, 2.0, 5.0, 20.0),
        partial(_scaled, focal=True, distance=True),
    ),
    _camera(
        "principal point", "% of the picture", (0.5, 1.0, 2.0, 5.0, 10.0, 25.0), _principal_point
    ),
    Axis(
        "camera",
        "principal point's x and y exchanged",
        "",
        _YES,
        _exchanged,
        **_is("principal-point-swapped"),
    ),
    _camera("K of twice the size", _TIMES, (2.0,), _FOR_SIZE, **_is("K-of-double-size")),
    _camera("K of half the size", _TIMES, (0.5,), _FOR_SIZE, **_is("K-of-half-size")),
    _camera("R transposed", "", _YES, lambda c, level, rng: {"R": c.R.T}, **_is("R-transposed")),
    _camera("axes of OpenGL", "", _YES, _in_axes(1.0, -1.0, -1.0), **_is("opengl")),
    _camera("axes of PyTorch3D", "", _YES, _in_axes(-1.0, -1.0, 1.0), **_is("pytorch3d")),
    _camera("camera-to-world for world-to-camera", "", _YES, _TO_WORLD, **_is("camera-to-world")),
    _camera("camera's x mirrored", "", _YES, _in_axes(-1.0, 1.0, 1.0)),
    Axis(
        "camera", "yaw of one camera, beside a right one", "degrees", _DEGREES, _one_turned, masks=2
    ),
    Axis(
        "camera",
        "yaw of one camera, beside three right ones",
        "degrees",
        _DEGREES,
        _one_turned,
        masks=4,
    ),
    Axis("camera", "yaw before a thin object", "degrees", _DEGREES, _of_thin(_YAW)),
    Axis("camera", "camera moved aside, thin object", _SIZE, _SIZES, _of_thin(_ASIDE)),
    Axis(
        "cloud",
        "cloud with z up",
        "",
        _YES,
        _framed([[1, 0, 0], [0, 0, -1], [0, 1, 0]]),
        **_is("cloud-z-up"),
    ),
    Axis(
        "cloud",
        "cloud with x and z exchanged",
        "",
        _YES,
        _framed(np.eye(3)[::-1]),
        **_is("cloud-xz-swapped"),
    ),
    Axis(
        "cloud",
        "cloud with axes in another order",
        "",
        _YES,
        _framed([[0, 0, 1], [1, 0, 0], [0, 1, 0]]),
        **_is("cloud-zxy"),
    ),
    Axis("cloud", "cloud of the other handedness", "", _YES, _framed(np.diag([-1, 1, 1]))),
    Axis(
        "cloud", "cloud in smaller units", _TIMES, _UNITS, _framed(np.eye(3)), mistakes=_TOO_LARGE
    ),
    Axis(
        "cloud",
        "cloud in larger units",
        _TIMES,
        _UNITS,
        _framed(np.eye(3), -1.0),
        mistakes=_TOO_SMALL,
    ),
    _start(
        "start far off",
        _SIZE,
        (*_SIZES, 100.0, 1000.0),
        lambda c, p, rng: c.initial + p / 100.0 * _direction(rng),
    ),
    _start(
        "start partly behind the camera",
        "% of its points",
        (0.1, 1.0, 5.0, 20.0, 50.0, 100.0),
        _behind,
    ),
    _start("start flat along the line of sight", "% gone", _GONE, _flat),
    _start("start collinear", "% gone", _GONE, _collinear),
    _start("start shrunk into one pixel", _TIMES, (1.1, 1.5, 2.0, 5.0, 20.0, 1000.0), _shrunk),
    _start("outliers", "% of the points", _STRAYS, _with_outliers, adds_points=True),
    _start(
        "outliers close by",
        "% of the points",
        _STRAYS,
        partial(_with_outliers, spread=SPREAD_CLOSE),
        adds_points=True,
    ),
    _start("outliers in one clump", "% of the points", _STRAYS, _with_clump, adds_points=True),
    _start(
        "floor under the object",
        "% of the points",
        (2.0, 5.0, 10.0, 20.0, 50.0, 100.0),
        _with_floor,
        adds_points=True,
    ),
    _start(
        "one stray point",
        "sizes away",
        (1.0, *_UP),
        lambda c, r, rng: _added(c, r * _direction(rng)[None]),
        adds_points=True,
    ),
    _start(
        "duplicates",
        "% of the points",
        (10.0, 50.0, 100.0, 400.0),
        _with_duplicates,
        adds_points=True,
    ),
    _start(
        "noise",
        _SIZE,
        (0.2, 0.5, *_SIZES[:5]),
        lambda c, p, rng: c.initial + p / 100.0 * rng.normal(size=c.initial.shape),
    ),
    _start("few points", "points", (512, 256, 64, 16, 4, 2), _counted),
    _start("many points", "points", (2048, 16384, 131072, 1_000_000), _counted),
    _start("uneven density", "times as dense", (2.0, 5.0, 20.0, 100.0, 1000.0), _uneven),
    Axis("cloud", "thin object", "times thinner", (2.0, 4.0, 8.0, 16.0, 32.0, 64.0), _thin),
    Axis("cloud", "holed object", "% of it missing", (10.0, 20.0, 40.0, 60.0, 80.0, 95.0), _holed),
    _settings("sigma^2 too large, paper", _TIMES, _UP, _SIGMA),
    _settings("sigma^2 too small, paper", _TIMES, _DOWN, _SIGMA),
    _settings("gamma too large, paper", _TIMES, _UP, _GAMMA),
    _settings("gamma too small, paper", _TIMES, (*_DOWN, 0.0), _GAMMA),
    _settings("learning rate too high", _TIMES, _UP, _rate),
    _settings("learning rate too low", _TIMES, _DOWN, _rate),
    _settings("few steps", "steps", (24, 12, 6, 3, 1, 0), _steps),
    _settings("many steps", "steps", (96, 200, 500, 1000), _steps),
    Axis(
        "image", "small in the picture", "% of its width", (50.0, 20.0, 10.0, 5.0, 2.0, 1.0), _small
    ),
    Axis("image", "small picture", "px", (128, 64, 32, 16, 8), _pictured),
    Axis("image", "large picture", "px", (512, 1024, 2048, 4096, 8192), _pictured),
)
"""All of them, in the order in which they are shown."""
