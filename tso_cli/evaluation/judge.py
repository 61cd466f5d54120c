"""Judging predicted shapes against ground truth: which files belong together, what is measured, under which convention."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError
from ..geometry.camera import Camera
from ..geometry.points import Array, farthest_point_sample, normalise_longest_side
from ..geometry.view import View
from ..io import shapes
from ..io.cameras import find_camera, read_camera, read_cameras
from ..io.images import read_mask
from ..version import __version__
from . import metrics
from .footprint import IOU_MEANS, window_iou
from .metrics import chamfer, emd, f_score, iou

METRICS = ("chamfer", "f_score", "emd", "iou")
PROTOCOLS = ("plain", "capnet")
# What the paper's evaluation keeps of every shape.
CAPNET_POINTS = 1024
# What a record holds of each metric, in the order of the table.
FIELDS = {
    "chamfer": ("forward", "backward", "chamfer"),
    "f_score": ("precision", "recall", "f_score"),
    "emd": ("emd",),
    "iou": ("iou",),
}
# In a folder a .txt is more often a note than a cloud.
FOLDER_SUFFIXES = tuple(suffix for suffix in shapes.SUFFIXES if suffix != ".txt")
_MASKS = (".png", ".mask.png", "/mask.png", ".npy", ".bmp", ".tif", ".tiff", ".webp", ".gif", ".jpg", ".jpeg")
_CAMERAS = (".camera.json", ".json", "/camera.json", "/cameras.json")

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class EvalConfig:
    """What to measure, and how.

    Parameters
    ----------
    metrics : some of "chamfer", "f_score", "emd", "iou".
    protocol : "plain" takes coordinates as they are. "capnet" is the paper's: each cloud is thinned to ``points``, then centred
        on its own bounding box and scaled to longest side 1, which hides errors of scale and place; EMD squares its distances.
    points : thin every cloud to so many points first, by farthest-point sampling from its first point on (of a surface, the
        first drawn). None takes all points; under "capnet" it takes 1,024, and all of a cloud that has fewer.
    samples : points drawn from the surface of a mesh or voxel grid.
    threshold : of the F-score, in units of the clouds as compared; None for 1 % of the target's longest side.
    sigma_sq : of the IoU: take the paper's silhouette, Gaussians of this variance in px^2 over the whole image, in place of the
        footprint of `tso_cli.evaluation.footprint`.
    seed : of the surface samples. Prediction and target draw from streams of their own: of equal surfaces the distance is that
        of two samples, as it is of any prediction that has the true surface, and not 0.
    as_vertices : of meshes take the vertices, not the surface.

    Raises
    ------
    InputError
        A value is out of range.
    """

    metrics: tuple[str, ...] = ("chamfer",)
    protocol: str = "plain"
    points: int | None = None
    samples: int = 16384
    threshold: float | None = None
    sigma_sq: float | None = None
    seed: int = 0
    as_vertices: bool = False

    def __post_init__(self) -> None:
        unknown = [name for name in self.metrics if name not in METRICS]
        if unknown or not self.metrics:
            raise InputError(f"metrics are {list(self.metrics)}, expected some of {', '.join(METRICS)}")
        if self.protocol not in PROTOCOLS:
            raise InputError(f"protocol is {self.protocol!r}, expected one of {', '.join(PROTOCOLS)}")
        if self.points is not None and self.points < 2:
            raise InputError(f"--points is {self.points}, expected at least 2")
        if self.samples < max(2, self.points or 2):
            raise InputError(f"--samples is {self.samples}, expected at least {max(2, self.points or 2)} (as many as --points)")
        if self.seed < 0:
            raise InputError(f"--seed is {self.seed}, expected 0 or more")
        for name, value in (("--threshold", self.threshold), ("--sigma-sq", self.sigma_sq)):
            if value is not None and not 0.0 < value < np.inf:
                raise InputError(f"{name} is {value:g}, expected a number > 0")


@dataclass(frozen=True)
class Pair:
    """A prediction and its target; for IoU also the masks and the camera files that go with them."""

    name: str
    prediction: Path
    target: Path
    mask: Path | None = None
    camera: Path | None = None


def find_pairs(
    prediction: Path,
    target: Path,
    mask: Path | None = None,
    camera: Path | None = None,
    suffix: str = "",
) -> list[Pair]:
    """Two files, or the files of two folders matched by name: the path below the folder without its suffix.

    Parameters
    ----------
    prediction, target : both files or both folders (subfolders included; hidden files, and files of other kinds, left out).
    mask, camera : a file for all pairs, or a folder with one file for each name (NAME.png, NAME.camera.json and the like).
    suffix : in folders, take only predictions whose names end in this, and match them without it: ".refined".

    Raises
    ------
    InputError
        A file and a folder; a folder without shapes; a name on one side only, or twice on a side; no mask or camera for a name.
    """
    for path in (prediction, target, *(extra for extra in (mask, camera) if extra is not None)):
        if not path.exists():
            raise InputError(f"{path}: no such file or folder")
    if prediction.is_dir() != target.is_dir():
        folder, file = (prediction, target) if prediction.is_dir() else (target, prediction)
        raise InputError(f"{folder} is a folder and {file} a file, expected two files or two folders")
    if prediction.is_dir():
        ours, theirs = _by_name(prediction, suffix), _by_name(target)
        _require_same_names(prediction, ours, target, theirs, suffix)
        pairs = [(name, ours[name], theirs[name]) for name in sorted(ours)]
    else:
        if suffix:
            raise InputError(f"--suffix {suffix} matches names in folders, but {prediction} is a file")
        pairs = [(prediction.stem, prediction, target)]
    return [
        Pair(name, first, second, _companion(mask, name, _MASKS, "mask"), _companion(camera, name, _CAMERAS, "camera"))
        for name, first, second in pairs
    ]


def evaluate(pairs: Sequence[Pair], config: EvalConfig, progress: Progress | None = None) -> dict[str, Any]:
    """Measure every pair.

    Parameters
    ----------
    progress : called with (done, total) after each pair.

    Returns
    -------
    JSON-able {"pairs": [{"name", ...}], "mean": {...}, "convention": {...}}; distances are raw, in units of the files or, under
    the capnet protocol, of the longest side.

    Raises
    ------
    InputError
        A file cannot be used; the message names it.
    """
    if not pairs:
        raise InputError("no pair to judge, expected at least one")
    records = []
    for done, pair in enumerate(pairs, 1):
        records.append(judge_pair(pair, config))
        if progress:
            progress(done, len(pairs))
    fields = [field for name in METRICS if name in config.metrics for field in FIELDS[name]]
    mean = {field: float(np.mean([record[field] for record in records])) for field in fields}
    return {"pairs": records, "mean": mean, "convention": _convention(config)}


def judge_pair(pair: Pair, config: EvalConfig) -> dict[str, Any]:
    """The record of one pair: its metrics, and what was read from the two files."""
    kinds = [shapes.shape_kind(path) for path in (pair.prediction, pair.target)]
    ours, theirs = _read(pair.prediction, config, [config.seed, 1]), _read(pair.target, config, config.seed)
    record: dict[str, Any] = {"name": pair.name}
    with _naming(f"{pair.prediction} against {pair.target}"):
        compared = ours, theirs
        if config.protocol == "capnet":
            compared = normalise_longest_side(ours, "prediction"), normalise_longest_side(theirs, "target")
        if "chamfer" in config.metrics:
            distance = chamfer(*compared)
            record.update(forward=distance.forward, backward=distance.backward, chamfer=distance.chamfer)
        if "f_score" in config.metrics:
            score = f_score(*compared, config.threshold)
            record.update(precision=score.precision, recall=score.recall, f_score=score.f_score, threshold=score.threshold)
        if "emd" in config.metrics:
            record["emd"] = emd(*compared, squared=config.protocol == "capnet")
    if "iou" in config.metrics:
        record.update(_iou(ours, pair, config.sigma_sq))
    record.update(
        prediction=str(pair.prediction),
        target=str(pair.target),
        prediction_kind=kinds[0],
        target_kind=kinds[1],
        prediction_points=len(ours),
        target_points=len(theirs),
        target_longest_side=float(np.ptp(theirs, axis=0).max()),
        centre_offset=float(np.linalg.norm(_centre(ours) - _centre(theirs))),
    )
    return record


def _read(path: Path, config: EvalConfig, seed: int | list[int]) -> Array:
    points = shapes.read_shape(path, config.samples, seed, config.as_vertices)
    if config.points is None and (config.protocol != "capnet" or len(points) <= CAPNET_POINTS):
        return points
    count = config.points or CAPNET_POINTS
    if len(points) < count:
        raise InputError(f"{path}: holds {len(points):,} points, expected at least the {count:,} of --points")
    return points[farthest_point_sample(points, count)]


def _centre(points: Array) -> Array:
    return points.min(axis=0) / 2.0 + points.max(axis=0) / 2.0


def _iou(points: Array, pair: Pair, sigma_sq: float | None) -> dict[str, Any]:
    """Mean IoU over the views of a pair, of the silhouette of ``points`` in their own frame."""
    scores = []
    for mask_path, camera in _views(pair):
        mask = read_mask(mask_path)
        height, width = mask.shape
        if camera is None:
            camera = read_camera(_camera_of(pair, mask_path), width, height, mask_path)
        if (camera.width, camera.height) != (width, height):
            raise InputError(f"{pair.camera}: a camera is for {camera.width}x{camera.height}, {mask_path} is {width}x{height}")
        if sigma_sq is None:
            scores.append(window_iou(points, View(mask, camera, name=str(mask_path))))
            continue
        from ..silhouette.projection import silhouette_of

        with _naming(f"{pair.prediction} against {mask_path}"):
            scores.append(iou(silhouette_of(points, camera, sigma_sq), mask))
    return {"iou": float(np.mean(scores)), "views": len(scores)}


def _views(pair: Pair) -> Iterator[tuple[Path, Camera | None]]:
    """Mask files, with their cameras where the camera file names the masks."""
    if pair.mask is not None:
        yield pair.mask, None
        return
    if pair.camera is None:
        raise InputError("IoU needs --mask, with --camera or a camera file beside the mask")
    for number, view in enumerate(read_cameras(pair.camera)):
        if view.mask is None:
            raise InputError(f"{pair.camera}: view {number} names no mask, expected one or --mask")
        yield view.mask, view.camera


def _camera_of(pair: Pair, mask: Path) -> Path:
    found = pair.camera or find_camera(mask)
    if found is None:
        raise InputError(f"{mask}: no {mask.stem}.camera.json or camera.json beside it, expected one or --camera")
    return found


def _convention(config: EvalConfig) -> dict[str, Any]:
    capnet = config.protocol == "capnet"
    kept = config.points or (CAPNET_POINTS if capnet else None)
    at_most = " at most" if config.points is None else ""
    threshold = f"{config.threshold:g}" if config.threshold else f"{metrics.F_SCORE_SHARE:.0%} of the target's longest side"
    measured = {
        "chamfer": "squared distances, mean over points; forward target -> prediction, backward prediction -> target, "
        "chamfer their sum",
        "f_score": f"distance < threshold, {threshold}",
        "emd": f"optimal one-to-one assignment, mean {'squared' if capnet else 'Euclidean'} distance",
        "iou": IOU_MEANS
        if config.sigma_sq is None
        else f"Gaussian silhouette (sigma^2 {config.sigma_sq:g} px^2) > 0.5 against mask > 0.5 over the image, mean over views",
    }
    return {
        **{name: text for name, text in measured.items() if name in config.metrics},
        "protocol": config.protocol,
        "normalisation": "each cloud, once thinned, centred on its bounding box, longest side 1" if capnet else "none",
        "points": kept,
        "thinning": f"{kept} points{at_most} (farthest-point)" if kept else "all points",
        "samples": config.samples,
        "surfaces": ("vertices of meshes, of grids " if config.as_vertices else "")
        + "points drawn from the surface, by prediction and target each for itself",
        "seed": config.seed,
        "device": "cpu",
        "precision": "float64",
        "version": __version__,
    }


def _by_name(folder: Path, suffix: str = "") -> dict[str, Path]:
    found: dict[str, Path] = {}
    for path in sorted(folder.rglob("*")):
        inside = path.relative_to(folder)
        if path.suffix.lower() not in FOLDER_SUFFIXES or not path.is_file() or any(p.startswith(".") for p in inside.parts):
            continue
        name = inside.with_suffix("").as_posix()
        if not name.endswith(suffix):
            continue
        name = name[: len(name) - len(suffix)]
        if name in found:
            raise InputError(f"{path} and {found[name]} have the same name, expected one file for {name!r}")
        found[name] = path
    if not found:
        ending = f"ending in {suffix} " if suffix else ""
        raise InputError(f"{folder}: no file {ending}to judge in this folder or below, expected {', '.join(FOLDER_SUFFIXES)}")
    return found


def _require_same_names(prediction: Path, ours: dict[str, Path], target: Path, theirs: dict[str, Path], suffix: str) -> None:
    lonely = [(prediction, target, sorted(set(ours) - set(theirs))), (target, prediction, sorted(set(theirs) - set(ours)))]
    parts = []
    for here, there, names in lonely:
        if names:
            shown = ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")
            parts.append(f"{here} has {shown}, which {there} has not")
    if parts:
        advice = ""
        if not suffix and any(name.endswith(".refined") for name in ours):
            advice = " (--suffix .refined takes the predictions that end so)"
        raise InputError("; ".join(parts) + ": expected the same names in both" + advice)


def _companion(where: Path | None, name: str, endings: Sequence[str], what: str) -> Path | None:
    if where is None or not where.is_dir():
        return where
    for ending in endings:
        path = Path(f"{where / name}{ending}")
        if path.is_file():
            return path
    raise InputError(f"{where}: no {what} for {name!r}, expected {name}{endings[0]} or {name}{endings[1]}")


@contextmanager
def _naming(what: str) -> Iterator[None]:
    """Errors of functions that know arrays alone get the names of the files."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{what}: {error}") from None
