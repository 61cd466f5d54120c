"""Comparison of predicted shapes with ground truth under a stated convention."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError, prefixed
from ..geometry.arrays import Array
from ..geometry.points import farthest_point_sample, normalise_longest_side
from ..io.clouds import read_cloud
from ..io.masks import MaskChoice
from ..io.shapes import read_shape, read_surface, shape_kind
from ..losses.silhouette import silhouette_of
from ..version import __version__
from .config import FIELDS, METRICS, EvalConfig
from .footprint import IOU_MEANS, Solid, window_iou
from .metrics import F_SCORE_SHARE, chamfer, emd, f_score, iou
from .pairs import Pair

# Size of every cloud in the paper's evaluation.
CAPNET_POINTS = 1024

Progress = Callable[[int, int], None]


def evaluate(
    pairs: Sequence[Pair], config: EvalConfig, progress: Progress | None = None
) -> dict[str, Any]:
    """Measure every pair; ``progress`` is called with (done, total) after each.

    Returns {"pairs": [{"name", ...}], "mean": {...}, "convention": {...}}, which JSON can hold.
    Distances are raw, in units of the files, or in longest sides under the protocol "capnet".
    Raises InputError that names the file if one cannot be used.
    """
    records = []
    for done, pair in enumerate(pairs, 1):
        records.append(_measure(pair, config))
        if progress:
            progress(done, len(pairs))
    fields = [field for name in METRICS if name in config.metrics for field in FIELDS[name]]
    mean = {field: float(np.mean([record[field] for record in records])) for field in fields}
    return {"pairs": records, "mean": mean, "convention": _convention(config)}


def _measure(pair: Pair, config: EvalConfig) -> dict[str, Any]:
    prediction = _read(pair.prediction, config, [config.seed, 1], pair.index)
    target = _read(pair.target, config, config.seed, pair.index)
    record: dict[str, Any] = {"name": pair.name}
    capnet = config.protocol == "capnet"
    with prefixed(f"{pair.prediction} against {pair.target}: "):
        compared = prediction, target
        if capnet:
            compared = (
                normalise_longest_side(prediction, "prediction"),
                normalise_longest_side(target, "target"),
            )
        if "chamfer" in config.metrics:
            distance = chamfer(*compared)
            record |= {name: getattr(distance, name) for name in FIELDS["chamfer"]}
        if "f_score" in config.metrics:
            score = f_score(*compared, config.threshold)
            fields = (*FIELDS["f_score"], "threshold")
            record |= {name: getattr(score, name) for name in fields}
        if "emd" in config.metrics:
            record["emd"] = emd(*compared, squared=capnet)
    if "iou" in config.metrics:
        record.update(_measure_iou(prediction, pair, config))
    return record | {
        "prediction": str(pair.prediction),
        "target": str(pair.target),
        "prediction_kind": shape_kind(pair.prediction),
        "target_kind": shape_kind(pair.target),
        "prediction_points": len(prediction),
        "target_points": len(target),
        "target_longest_side": float(np.ptp(target, axis=0).max()),
        "centre_offset": float(np.linalg.norm(_centre(prediction) - _centre(target))),
    }


def _read(path: Path, config: EvalConfig, seed: int | list[int], index: int | None) -> Array:
    if index is None:
        points = read_shape(path, config.samples, seed, config.as_vertices)
    else:
        points = read_cloud(path, extended=False, index=index).points
    if config.points is None and (config.protocol != "capnet" or len(points) <= CAPNET_POINTS):
        return points
    count = config.points or CAPNET_POINTS
    if len(points) < count:
        raise InputError(
            f"{path}: holds {len(points):,} points, expected at least {count:,}; "
            f"thin the clouds to {len(points)} (`points`)"
        )
    return points[farthest_point_sample(points, count)]


def _centre(points: Array) -> Array:
    return points.min(axis=0) / 2.0 + points.max(axis=0) / 2.0


def _measure_iou(points: Array, pair: Pair, config: EvalConfig) -> dict[str, Any]:
    scores = []
    thinned = config.as_vertices or config.points is not None or config.sigma_sq is not None
    surface = None if thinned else read_surface(pair.prediction)
    solid = Solid(*(surface or (points,)))
    for view in pair.views(MaskChoice(config.label, config.mask_index)):
        if config.sigma_sq is None:
            scores.append(window_iou(solid, view))
            continue
        with prefixed(f"{pair.prediction} against {view.name}: "):
            drawn = silhouette_of(points, view.camera, config.sigma_sq)
            scores.append(iou(drawn, view.mask, view.known))
    return {"iou": float(np.mean(scores)), "views": len(scores)}


def _convention(config: EvalConfig) -> dict[str, Any]:
    capnet = config.protocol == "capnet"
    count = config.points or (CAPNET_POINTS if capnet else None)
    at_most = " at most" if config.points is None else ""
    threshold = f"{F_SCORE_SHARE:.0%} of the target's longest side"
    if config.threshold:
        threshold = f"{config.threshold:g}"
    iou_means = IOU_MEANS
    if config.sigma_sq is not None:
        iou_means = (
            f"Gaussian silhouette (sigma^2 {config.sigma_sq:g} px^2) > 0.5 against mask > 0.5 over "
            "the image, mean over views"
        )
    metrics = {
        "chamfer": "squared distances, mean over points; forward target -> prediction, "
        "backward prediction -> target, chamfer their sum",
        "f_score": f"distance < threshold, {threshold}",
        "emd": "optimal one-to-one assignment, "
        f"mean {'squared' if capnet else 'Euclidean'} distance",
        "iou": iou_means,
    }
    return {
        **{name: text for name, text in metrics.items() if name in config.metrics},
        "protocol": config.protocol,
        "normalisation": "each cloud, once thinned, centred on its bounding box, longest side 1"
        if capnet
        else "none",
        "points": count,
        "thinning": f"{count} points{at_most} (farthest-point)" if count else "all points",
        "samples": config.samples,
        "surfaces": ("vertices of meshes, of grids " if config.as_vertices else "")
        + "points drawn from the surface, by prediction and target each for itself",
        "seed": config.seed,
        "device": "cpu",
        "precision": "float64",
        "version": __version__,
    }
