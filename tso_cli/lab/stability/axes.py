"""The axes of stability: what can be wrong with the input, each from harmless to hopeless.

Every function alters a `Case` by one level. Random numbers only choose directions and places, so
that one seed gives all levels of an axis the same ones. An input that no `View` or `Camera` accepts
raises InputError. Gross mistakes undo a hypothesis of the diagnosis, which then mends them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, gaussian_filter, shift

from ...diagnosis.assumptions import Assumption, as_meant
from ...diagnosis.findings import Finding
from ...diagnosis.hypotheses import HYPOTHESES, OF_WIDTH
from ...geometry.camera import Array, Camera
from ...geometry.points import farthest_point_sample
from ...geometry.resampling import Box, area_resize
from ...geometry.rotations import from_vectors
from ...geometry.view import View, object_box
from ...optimisation.presets import PAPER_POINTS, SIGMA_SQ
from ...refinement.config import RefineConfig
from ..studies.cases import Case

Rng = np.random.Generator
Bits = NDArray[np.bool_]
Mask = NDArray[np.float32]
Alter = Callable[..., Case]
Fields = Callable[[Camera, float, Rng], dict[str, Any]]
Levels = tuple[float, ...]
Group = Literal["settings", "mask", "camera", "cloud", "image"]

# How many times as thin the thin object of a pair is, and bars across an object full of holes.
THIN, BARS = 8.0, 8
# Of the object's size: radius of a hole in its mask, blur before a wrong threshold, jitter of
# repeated points.
HOLE, BLUR, JITTER = 0.04, 0.03, 0.005
# Half the box that outliers are in, far off and close by; the object's longest side is 1.
SPREAD, SPREAD_CLOSE = 2.5, 0.5
# How far off a clump of outliers is, and its standard deviation.
CLUMP, CLUMP_SIZE = 3.0, 0.02
FLOOR = 2.0
"""How many times as wide as the object the floor under it is."""


@dataclass(frozen=True, eq=False)
class Axis:
    """One thing that is wrong, and how wrong.

    Parameters
    ----------
    group : what of the input is wrong. name, unit : in plain words.
    levels : from harmless to hopeless, in ``unit``; a single one where it is wrong or not.
    alter : (case, level, rng) -> the altered case. Target and dense stay, unless the object or the
        frame of the cloud is another. In group "settings" (config, level) -> changed fields of
        `RefineConfig`. With ``needs_other`` (case, level, rng, another case) -> the altered case.
    mistakes : of a gross mistake, which no result makes good: the hypothesis at each level.
    adds_points : the altered start begins with the points of the case, and added ones follow.
    masks : how many of the case's views the refinement sees. Masks are wrong in the first alone,
        cameras in all of them.
    """

    group: Group
    name: str
    unit: str
    levels: Levels
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
        """The case and settings to refine at ``level``; InputError where it cannot be made."""
        config = config or RefineConfig()
        if self.group == "settings":
            return case, replace(config, **self.alter(config, level))
        return self.alter(case, level, rng, *([other] if self.needs_other else [])), config

    @property
    def gross(self) -> bool:
        return bool(self.mistakes)

    def mistake(self, level: float) -> str:
        """The name of its hypothesis, "" where there is none."""
        return self.mistakes[self.levels.index(level)] if self.mistakes else ""

    @property
    def label(self) -> str:
        return f"{self.name}, {self.unit}" if self.unit else self.name

    def at(self, level: float) -> str:
        """The level in words; "" where it is wrong or not."""
        return f"{level:g} {self.unit}".strip() if len(self.levels) > 1 or self.unit else ""

    def own(self, case: Case, points: Array) -> Array:
        """The result's points [M, 3] that were in the start of ``case``, without added ones."""
        return points[: len(case.initial)] if self.adds_points else points


def _first(case: Case, **changes: Any) -> Case:
    """The first view changed."""
    return replace(case, views=(replace(case.views[0], **changes), *case.views[1:]))


def _sideways(rng: Rng) -> Array:
    """A unit vector of the image plane [3]."""
    angle = rng.uniform(0.0, 2.0 * np.pi)
    return np.array([np.cos(angle), np.sin(angle), 0.0])


def _direction(rng: Rng) -> Array:
    direction = rng.normal(size=3)
    unit: Array = direction / np.linalg.norm(direction)
    return unit


# Masks: another one [H, W] for the foreground [H, W] of the first view.


def _mask(name: str, unit: str, levels: Levels, change: Callable[..., Any], masks: int = 1) -> Axis:
    def alter(case: Case, level: float, rng: Rng) -> Case:
        inside = case.views[0].mask > 0.5
        return _first(case, mask=change(inside, level, rng).astype(np.float32))

    return Axis("mask", name, unit, levels, alter, masks=masks)


def _size(inside: Bits) -> float:
    """Longest side of the foreground's box, px."""
    return float(max(np.ptp(places) + 1 for places in np.nonzero(inside)))


def _least(inside: Bits, order: Array, percent: float) -> Bits:
    """The pixels of ``inside`` where ``order`` is least."""
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


def _speckled(inside: Bits, percent: float, rng: Rng) -> Bits:
    return inside ^ (rng.random(inside.shape) < percent / 100.0)


def _thresholded(inside: Bits, threshold: float, rng: Rng) -> Any:
    return gaussian_filter(inside.astype(float), BLUR * _size(inside)) > threshold


def _occluded(inside: Bits, percent: float, rng: Rng) -> Bits:
    along = np.tensordot(_sideways(rng)[:2], np.indices(inside.shape), 1)
    return _least(inside, along, 100.0 - percent)


def _shifted(inside: Bits, percent: float, rng: Rng) -> Any:
    pixels = np.rint(percent / 100.0 * _size(inside) * _sideways(rng)[:2])
    return shift(inside.astype(np.uint8), pixels, order=0)


def _nearly_empty(inside: Bits, percent: float, rng: Rng) -> Bits:
    """The pixels nearest to one of them."""
    place = rng.choice(np.argwhere(inside))
    squared = np.square(np.indices(inside.shape) - place[:, None, None]).sum(0)
    return _least(inside, squared, percent)


def _nearly_full(inside: Bits, percent: float, rng: Rng) -> Bits:
    return inside | _least(~inside, distance_transform_edt(~inside), percent)


def _cut(case: Case, percent: float, rng: Rng) -> Case:
    """The picture ends within the object, on one of its four sides; the camera is right."""
    view, side = case.views[0], int(rng.integers(4))
    ends = np.array([(0, 0), view.mask.shape])
    share = percent / 100.0 if side < 2 else 1.0 - percent / 100.0
    places = np.nonzero(view.mask > 0.5)[side % 2]
    ends[side // 2, side % 2] = np.quantile(places, share) + side // 2
    (top, left), (bottom, right) = ends.tolist()
    box = (left - 0.5, top - 0.5, right - 0.5, bottom - 0.5)
    camera = view.camera.cropped(box, right - left, bottom - top)
    return _first(case, mask=view.mask[top:bottom, left:right], camera=camera)


def _boxed(inside: Bits, level: float, rng: Rng) -> Bits:
    """A detector's bounding box."""
    left, top, right, bottom = object_box(inside)
    boxed = np.zeros_like(inside)
    boxed[top:bottom, left:right] = True
    return boxed


def _of_other(case: Case, level: float, rng: Rng, other: Case) -> Case:
    camera = case.views[0].camera
    return _first(case, mask=_resized(other.views[0].mask, camera.width, camera.height))


def _masks_exchanged(case: Case, level: float, rng: Rng) -> Case:
    first, second, *others = case.views
    exchanged = replace(first, mask=second.mask), replace(second, mask=first.mask)
    return replace(case, views=(*exchanged, *others))


# Cameras: what changes in the cameras of all views.


def _camera(name: str, unit: str, levels: Levels, change: Fields) -> Axis:
    return Axis("camera", name, unit, levels, _seen(change))


def _seen(change: Fields) -> Alter:
    def alter(case: Case, level: float, rng: Rng) -> Case:
        cameras = (replace(view.camera, **change(view.camera, level, rng)) for view in case.views)
        return _with_cameras(case, cameras)

    return alter


def _with_cameras(case: Case, cameras: Any) -> Case:
    pairs = zip(case.views, cameras, strict=True)
    return replace(case, views=tuple(replace(view, camera=camera) for view, camera in pairs))


def _around_object(camera: Camera, degrees: float, rng: Rng, axis: int) -> dict[str, Any]:
    """Turned about the vertical axis of the world (1), or an axis of the camera (0, 2)."""
    turn = from_vectors(np.radians(degrees) * rng.choice([-1.0, 1.0]) * np.eye(3)[axis])
    return {"R": camera.R @ turn if axis == 1 else turn @ camera.R}


def _around_itself(camera: Camera, degrees: float, rng: Rng) -> dict[str, Any]:
    turn = from_vectors(np.radians(degrees) * _sideways(rng))
    return {"R": turn @ camera.R, "t": turn @ camera.t}


def _moved(camera: Camera, percent: float, rng: Rng) -> dict[str, Any]:
    return {"t": camera.t + percent / 100.0 * _sideways(rng)}


def _scaled(
    camera: Camera, factor: float, rng: Rng, focal: bool = False, distance: bool = False
) -> dict[str, Any]:
    """Focal length, distance or both, too long or too short."""
    factor **= float(rng.choice([-1.0, 1.0]))
    f, z = factor if focal else 1.0, factor if distance else 1.0
    return {"K": camera.K @ np.diag([f, f, 1.0]), "t": camera.t * [1.0, 1.0, z]}


def _mirrored(camera: Camera, level: float, rng: Rng) -> dict[str, Any]:
    signs = [-1.0, 1.0, 1.0]
    return {"R": np.diag(signs) @ camera.R, "t": camera.t * signs}


def _principal_point(camera: Camera, percent: float, rng: Rng) -> dict[str, Any]:
    pixels = percent / 100.0 * max(camera.width, camera.height)
    return {"K": camera.K + pixels * np.outer(_sideways(rng), [0.0, 0.0, 1.0])}


def _wider(case: Case) -> Case:
    """In pictures a half wider: in a square one, the two principal coordinates are the same."""
    views = []
    for view in case.views:
        width, height, more = view.camera.width, view.camera.height, view.camera.width // 2
        box = (-0.5 - more, -0.5, width - 0.5, height - 0.5)
        camera = view.camera.cropped(box, width + more, height)
        views.append(replace(view, mask=np.pad(view.mask, ((0, 0), (more, 0))), camera=camera))
    return replace(case, views=tuple(views))


# Gross mistakes: the input that a hypothesis of the diagnosis is right about.

_YES: Levels = (1.0,)

# What makes the mistake that a hypothesis is right about. The others are their own inverse.
INVERSE = {
    "pytorch3d": ("pix3d", "R-transposed"),
    "opengl-camera-to-world": ("opengl", "camera-to-world"),
    "mask-turned-left": ("mask-turned-right",),
}


def _mistake(name: str, mistake: str) -> Axis:
    """``mistake`` : the name of a hypothesis, or of two that are joined by "+"."""
    wrong = Finding(mistake).hypotheses[0]
    group: Group = "cloud" if wrong.of_cloud else "mask" if wrong.of_mask else "camera"
    alter = partial(_mistaken, mistake.split("+"))
    return Axis(group, name, "", _YES, alter, mistakes=(mistake,))


def _mistaken(names: Sequence[str], case: Case, level: float, rng: Rng) -> Case:
    for inverse in (HYPOTHESES[one] for name in names for one in INVERSE.get(name, (name,))):
        if inverse.of_cloud:
            case = _turned(case, inverse.matrix)
        elif inverse.of_mask:
            inside = (case.views[0].mask > 0.5).astype(np.float32)
            view = replace(case.views[0], mask=inside)
            case = _first(case, mask=as_meant(view, [Assumption(inverse)]).mask)
        else:
            case = _wider(case) if inverse.name == "principal-point-swapped" else case
            case = _with_cameras(case, (inverse.camera(view.camera) for view in case.views))
    return case


def _width(name: str, times: float) -> Axis:
    return replace(_camera(name, _TIMES, (times,), _of_width), mistakes=(OF_WIDTH,))


def _of_width(camera: Camera, factor: float, rng: Rng) -> dict[str, Any]:
    """K of the picture that is ``factor`` times as wide."""
    size = (round(factor * length) for length in (camera.width, camera.height))
    return {"K": camera.resized(*size).K}


# Clouds: another start [N, 3], or the whole cloud in another frame.


def _start(
    name: str, unit: str, levels: Levels, change: Callable[..., Array], adds_points: bool = False
) -> Axis:
    def alter(case: Case, level: float, rng: Rng) -> Case:
        return replace(case, initial=change(case, level, rng))

    return Axis("cloud", name, unit, levels, alter, adds_points=adds_points)


def _clouds(case: Case, change: Callable[[Array], Array]) -> Case:
    initial, target, dense = map(change, (case.initial, case.target, case.dense))
    return replace(case, initial=initial, target=target, dense=dense)


def _turned(case: Case, axes: Array) -> Case:
    return _clouds(case, lambda points: points @ axes)


def _in_units(case: Case, factor: float, rng: Rng, power: float = 1.0) -> Case:
    return _clouds(case, lambda points: factor**power * points)


def _other_hand(case: Case, level: float, rng: Rng) -> Case:
    return _clouds(case, lambda points: points * [-1.0, 1.0, 1.0])


def _far_off(case: Case, percent: float, rng: Rng) -> Array:
    return case.initial + percent / 100.0 * _direction(rng)


def _behind(case: Case, percent: float, rng: Rng) -> Array:
    """Nearer to the camera, until this share of the points is behind it."""
    camera = case.views[0].camera
    depth = case.initial @ camera.R[2] + camera.t[2]
    return case.initial - (np.quantile(depth, percent / 100.0) + 1e-3) * camera.R[2]


def _flat(case: Case, percent: float, rng: Rng) -> Array:
    """Along the line of sight."""
    forward = case.views[0].camera.R[2]
    depth = (case.initial - case.initial.mean(0)) @ forward
    return case.initial - percent / 100.0 * np.outer(depth, forward)


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
    """A share of the cloud's points, at least one."""
    return max(1, round(percent / 100.0 * len(case.initial)))


def _with_outliers(case: Case, percent: float, rng: Rng, spread: float = SPREAD) -> Array:
    return _added(case, rng.uniform(-spread, spread, (_share(case, percent), 3)))


def _with_clump(case: Case, percent: float, rng: Rng) -> Array:
    place = CLUMP * _direction(rng)
    return _added(case, place + CLUMP_SIZE * rng.normal(size=(_share(case, percent), 3)))


def _with_one_outlier(case: Case, distance: float, rng: Rng) -> Array:
    return _added(case, distance * _direction(rng)[None])


def _with_floor(case: Case, percent: float, rng: Rng) -> Array:
    """A ground plane, as in a scan that the object was not cut out of; y is up."""
    low, high = case.initial.min(0), case.initial.max(0)
    middle, width = (low + high) / 2.0, FLOOR * max(high[0] - low[0], high[2] - low[2])
    floor = middle + width * rng.uniform(-0.5, 0.5, (_share(case, percent), 3))
    floor[:, 1] = low[1]
    return _added(case, floor)


def _with_duplicates(case: Case, percent: float, rng: Rng) -> Array:
    """Of points in one half of the cloud."""
    half = np.argsort(case.initial @ _direction(rng))[: -(-len(case.initial) // 2)]
    return _added(case, case.initial[rng.choice(half, _share(case, percent))])


def _noisy(case: Case, percent: float, rng: Rng) -> Array:
    return case.initial + percent / 100.0 * rng.normal(size=case.initial.shape)


def _counted(case: Case, count: float, rng: Rng) -> Array:
    if count <= len(case.initial):
        return case.initial[farthest_point_sample(case.initial, int(count))]
    repeated = case.initial[rng.integers(len(case.initial), size=int(count) - len(case.initial))]
    return _added(case, repeated + JITTER * rng.normal(size=repeated.shape))


def _uneven(case: Case, factor: float, rng: Rng) -> Array:
    """As many points, ``factor`` times as dense at one end as at the other."""
    along = case.initial @ _direction(rng)
    share = factor ** ((along - along.min()) / np.ptp(along))
    drawn = rng.choice(len(along), len(along), p=share / share.sum())
    return case.initial[drawn] + JITTER * rng.normal(size=case.initial.shape)


# Objects and pictures.


def _thin(case: Case, factor: float, rng: Rng) -> Case:
    """Thinner across the first picture, whose mask is exact; other views are left out."""
    view, camera = case.views[0], case.views[0].camera
    middle = camera.K[0, 2]
    left, right = middle + factor * (np.array([-0.5, camera.width - 0.5]) - middle)
    box = (left, -0.5, right, camera.height - 0.5)
    mask = _cells(view.mask, box, camera.width, camera.height)
    spared, across = 1.0 - 1.0 / factor, camera.R[0]
    thin = replace(case, views=(replace(view, mask=mask),))
    return _clouds(thin, lambda p: p - spared * np.outer(p @ across + camera.t[0], across))


def _holed(case: Case, percent: float, rng: Rng) -> Case:
    """Only bars of the object are left, along the first picture's lines of sight, and one view."""
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
    return _first(case, camera=_seen(_YAW)(case, degrees, rng).views[0].camera)


def _of_thin(change: Fields) -> Alter:
    return lambda case, level, rng: _seen(change)(_thin(case, THIN, rng), level, rng)


def _in_picture(view: View, box: Box) -> View:
    """What the picture shows in ``box``, in a picture of the same size."""
    width, height = view.camera.width, view.camera.height
    camera = view.camera.cropped(box, width, height)
    return replace(view, mask=_cells(view.mask, box, width, height), camera=camera)


def _small(case: Case, percent: float, rng: Rng) -> Case:
    """The object has this size in a picture of the same size."""
    views = []
    for view in case.views:
        width, height = view.camera.width, view.camera.height
        more = (100.0 * _size(view.mask > 0.5) / (percent * max(width, height)) - 1.0) / 2.0
        low, high = (-more * width - 0.5, -more * height - 0.5), 1.0 + more
        views.append(_in_picture(view, (*low, high * width - 0.5, high * height - 0.5)))
    return replace(case, views=tuple(views))


def _pictured(case: Case, pixels: float, rng: Rng) -> Case:
    views = []
    for view in case.views:
        sizes = view.camera.width, view.camera.height
        width, height = (max(1, round(pixels / max(sizes) * size)) for size in sizes)
        camera = view.camera.resized(width, height)
        views.append(replace(view, mask=_resized(view.mask, width, height), camera=camera))
    return replace(case, views=tuple(views))


def _resized(mask: Mask, width: int, height: int) -> Mask:
    rows, columns = mask.shape
    if width <= columns and height <= rows:
        return _cells(mask, (-0.5, -0.5, columns - 0.5, rows - 0.5), width, height)
    # Enlarged pixels stay squares; in float64 a picture of 8,192 pixels each way fills half a GiB.
    return mask[(np.arange(height) * rows // height)[:, None], np.arange(width) * columns // width]


def _cells(mask: Mask, box: Box, width: int, height: int) -> Mask:
    """Background beyond the picture."""
    means, covered = area_resize(mask, box, width, height)
    return np.clip(means * covered, 0.0, 1.0).astype(np.float32)


# Settings: (settings, level) -> the changed fields.


def _paper(name: str, value: float) -> Callable[[RefineConfig, float], dict[str, Any]]:
    return lambda config, factor: {"preset": "paper", name: factor * value}


def _rate(config: RefineConfig, factor: float) -> dict[str, Any]:
    return {"learning_rate": factor * config.settings().learning_rate}


def _steps(config: RefineConfig, steps: float) -> dict[str, Any]:
    return {"steps": int(steps)}


_settings = partial(Axis, "settings")
_SIGMA, _GAMMA = _paper("sigma_sq", SIGMA_SQ), _paper("gamma", PAPER_POINTS.gamma)
_YAW: Fields = partial(_around_object, axis=1)
_DILATED, _ERODED = partial(_edge_moved, outward=1.0), partial(_edge_moved, outward=-1.0)
_BOTH: Fields = partial(_scaled, focal=True, distance=True)
_IN_LARGER = partial(_in_units, power=-1.0)
_CLOSE = partial(_with_outliers, spread=SPREAD_CLOSE)
_UP, _DOWN = (2.0, 5.0, 10.0, 100.0, 1000.0), (0.5, 0.2, 0.1, 0.01, 0.001)
_SIZES, _SIZE = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0), "% of the object's size"
_SHARES, _AREA = (2.0, 5.0, 10.0, 20.0, 40.0, 80.0), "% of its area"
_GONE = (10.0, 20.0, 50.0, 80.0, 99.0, 100.0)
_DEGREES = (1.0, 2.0, 5.0, 10.0, 20.0, 45.0, 90.0)
_FACTORS, _TIMES = (1.01, 1.02, 1.05, 1.1, 1.25, 2.0, 5.0), "times"
_OUTLIERS, _OF_POINTS = (0.1, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0), "% of the points"
# Names of records.
_HIGH, _LOW = "threshold too high, 0.5 is right", "threshold too low, 0.5 is right"
_OTHER, _ONE_YAW = "mask of another object", "yaw of one camera"
# Factor between the units -> hypothesis about a cloud that is too large, or too small by it.
_UNITS = {
    2.0: ("cloud-twice-large", "cloud-half-large"),
    10.0: ("cloud-ten-times-large", "cloud-ten-times-small"),
    39.37: ("cloud-inches", "camera-inches"),
    100.0: ("cloud-centimetres", "camera-centimetres"),
    1000.0: ("cloud-millimetres", "camera-millimetres"),
}
_TOO_LARGE, _TOO_SMALL = zip(*_UNITS.values(), strict=True)

AXES: tuple[Axis, ...] = (
    _settings("nothing wrong", "", _YES, lambda config, level: {}),
    _mask("mask dilated", _SIZE, _SIZES, _DILATED),
    _mask("mask eroded", _SIZE, (0.5, 1.0, 2.0, 4.0, 8.0, 16.0), _ERODED),
    _mask("holes in the mask", _AREA, _SHARES, _with_holes),
    _mask("speckle", "% of the pixels", (0.1, 0.5, 2.0, 5.0, 15.0, 45.0), _speckled),
    _mask(_HIGH, "", (0.5, 0.6, 0.7, 0.8, 0.9, 0.98), _thresholded),
    _mask(_LOW, "", (0.5, 0.4, 0.3, 0.2, 0.1, 0.01), _thresholded),
    _mask("mask occluded", _AREA, _SHARES, _occluded),
    Axis("mask", "object cut by the border", _AREA, _SHARES, _cut),
    _mask("mask shifted", _SIZE, _SIZES, _shifted),
    _mistake("mask flipped left to right", "mask-flipped"),
    _mistake("mask upside down", "mask-upside-down"),
    _mistake("mask turned by 180 degrees", "mask-turned"),
    _mistake("mask inverted", "mask-inverted"),
    Axis("mask", _OTHER, "", _YES, _of_other, needs_other=True),
    _mask("box in place of the mask", "", _YES, _boxed),
    _mask("mask nearly empty", "% of it left", (80.0, 50.0, 20.0, 5.0, 1.0, 0.01), _nearly_empty),
    _mask("mask nearly full", "% of the rest filled", (2, 5, 20, 50, 90, 99, 100), _nearly_full),
    _mask("mask shifted, beside a right one", _SIZE, _SIZES, _shifted, masks=2),
    _mask("mask dilated, beside a right one", _SIZE, _SIZES, _DILATED, masks=2),
    Axis("mask", "two masks exchanged", "", _YES, _masks_exchanged, masks=2),
    Axis("mask", f"{_OTHER}, beside a right one", "", _YES, _of_other, needs_other=True, masks=2),
    Axis(
        "mask", f"{_OTHER}, beside three right ones", "", _YES, _of_other, needs_other=True, masks=4
    ),
    _camera("yaw of the camera", "degrees", (*_DEGREES, 180.0), _YAW),
    _camera("pitch of the camera", "degrees", (*_DEGREES, 180.0), partial(_around_object, axis=0)),
    _camera("roll of the camera", "degrees", (*_DEGREES, 180.0), partial(_around_object, axis=2)),
    _camera(
        "camera turned where it stands", "degrees", (0.2, 0.5, 1.0, 2.0, 5.0, 20.0), _around_itself
    ),
    _camera("camera moved aside", _SIZE, _SIZES, _moved),
    _camera("distance of the camera", _TIMES, _FACTORS, partial(_scaled, distance=True)),
    _camera("focal length", _TIMES, _FACTORS, partial(_scaled, focal=True)),
    _camera("focal length and distance", _TIMES, (1.1, 1.25, 1.5, 2.0, 5.0, 20.0), _BOTH),
    _camera("principal point", "% of the picture", (0.5, 1, 2, 5, 10, 25), _principal_point),
    _mistake("principal point's x and y exchanged", "principal-point-swapped"),
    _width("K of twice the size", 2.0),
    _width("K of half the size", 0.5),
    _width("K of another size", 4.05),
    _mistake("R transposed", "R-transposed"),
    _mistake("axes of OpenGL", "opengl"),
    _mistake("axes of PyTorch3D", "pix3d"),
    _mistake("R and T of PyTorch3D", "pytorch3d"),
    _mistake("camera-to-world for world-to-camera", "camera-to-world"),
    _camera("camera's x mirrored", "", _YES, _mirrored),
    Axis("camera", f"{_ONE_YAW}, beside a right one", "degrees", _DEGREES, _one_turned, masks=2),
    Axis(
        "camera", f"{_ONE_YAW}, beside three right ones", "degrees", _DEGREES, _one_turned, masks=4
    ),
    Axis("camera", "yaw before a thin object", "degrees", _DEGREES, _of_thin(_YAW)),
    Axis("camera", "camera moved aside, thin object", _SIZE, _SIZES, _of_thin(_moved)),
    _mistake("cameras of Blender, cloud of glTF", "opengl-camera-to-world+cloud-y-up"),
    _mistake("axes of OpenGL, cloud with z up", "opengl+cloud-z-up"),
    _mistake("cloud with z up", "cloud-z-up"),
    _mistake("cloud with x and z exchanged", "cloud-xz-swapped"),
    _mistake("cloud with axes in another order", "cloud-zxy"),
    Axis("cloud", "cloud of the other handedness", "", _YES, _other_hand),
    Axis("cloud", "cloud in smaller units", _TIMES, (*_UNITS,), _in_units, _TOO_LARGE),
    Axis("cloud", "cloud in larger units", _TIMES, (*_UNITS,), _IN_LARGER, _TOO_SMALL),
    _start("start far off", _SIZE, (*_SIZES, 100.0, 1000.0), _far_off),
    _start("start partly behind the camera", "% of its points", (0.1, 1, 5, 20, 50, 100), _behind),
    _start("start flat along the line of sight", "% gone", _GONE, _flat),
    _start("start collinear", "% gone", _GONE, _collinear),
    _start("start shrunk into one pixel", _TIMES, (1.1, 1.5, 2.0, 5.0, 20.0, 1000.0), _shrunk),
    _start("outliers", _OF_POINTS, _OUTLIERS, _with_outliers, True),
    _start("outliers close by", _OF_POINTS, _OUTLIERS, _CLOSE, True),
    _start("outliers in one clump", _OF_POINTS, _OUTLIERS, _with_clump, True),
    _start("floor under the object", _OF_POINTS, (2, 5, 10, 20, 50, 100), _with_floor, True),
    _start("one stray point", "sizes away", (1.0, *_UP), _with_one_outlier, True),
    _start("duplicates", _OF_POINTS, (10.0, 50.0, 100.0, 400.0), _with_duplicates, True),
    _start("noise", _SIZE, (0.2, 0.5, *_SIZES[:5]), _noisy),
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
    _settings("few steps", "steps", (10, 5, 3, 2, 1, 0), _steps),
    _settings("many steps", "steps", (40, 100, 200, 1000), _steps),
    Axis("image", "small in the picture", "% of its width", (50, 20, 10, 5, 2, 1), _small),
    Axis("image", "small picture", "px", (128, 64, 32, 16, 8), _pictured),
    Axis("image", "large picture", "px", (512, 1024, 2048, 4096, 8192), _pictured),
)
"""All axes, in the order in which they are shown."""
