"""How wide should the Gaussian be? The true cloud's silhouette against the mask, over sigma^2."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from ...device import one_thread
from ...errors import InputError
from ...geometry.camera import NEAR, Camera
from ...render import RenderSettings
from ...silhouette.projection import silhouette_of
from ...version import __version__
from ..charts.sigma_chart import Projections
from .discretised import UPSAMPLING, discrete_depth, discrete_mask
from .parts import SPLIT, SeenShape, Shape, see, shapes_of_part
from .protocol import Report

# From 0.05 to 3.2 px^2 in steps of the square root of two.
SIGMAS = tuple(round(0.05 * 2.0 ** (k / 2), 3) for k in range(13))
# The paper's choices.
PAPER = {"chair": 0.4, "car": 0.4, "airplane": 0.1}
SHOWN = (0.05, 0.1, 0.4, 0.8, 3.2)
"""sigma^2 of the pictures, which stand beside the discrete projections."""
SIZE = 64


def study_sigma(
    folder: Path,
    split_file: Path = SPLIT,
    part: str = "test",
    categories: Sequence[str] = (),
    limit: int | None = None,
    views: int = 4,
    sigmas: Sequence[float] = SIGMAS,
    seed: int = 0,
    report: Report | None = None,
) -> tuple[dict[str, Any], list[Projections]]:
    """Project the true cloud of 1,024 points of each shape and compare its silhouette with the mask at 64x64.

    Parameters
    ----------
    folder, split_file, part, categories, limit : as `shapes_of_part`.
    views : random views of each shape, as near as the whole object fits the frame.
    sigmas : sigma^2 in px^2, each between 0.01 and 256.
    report : called with (what, done, total).

    Returns
    -------
    A JSON-able record: {"study", "settings", "convention", "summary": {category or "all": {"l1", "missing", "stray": one for
    each sigma^2, "best", "l1_at_best", "paper", "l1_at_paper"}}, "claims", "shapes": [...]}, and for the first shape of
    each category the pictures of its first view.

    Raises
    ------
    InputError
        A shape is missing, or a sigma^2 is out of range.
    """
    sigmas = sorted(set(sigmas))
    if not sigmas or not all(0.01 <= sigma_sq <= (SIZE / 4) ** 2 for sigma_sq in sigmas):
        raise InputError(f"sigma^2 is {list(sigmas)}, expected numbers from 0.01 to {(SIZE // 4) ** 2} px^2")
    shapes = shapes_of_part(folder, split_file, part, categories, limit)
    settings = RenderSettings(views=views, size=(SIZE, SIZE))
    records: list[dict[str, Any]] = []
    maps: dict[str, Projections] = {}
    for done, shape in enumerate(shapes, 1):
        seen = see(shape, settings, seed)
        with one_thread(True):  # small images: threads would wait for each other longer than they work
            records.append({"category": shape.category, "shape": shape.name, **mask_errors(seen, sigmas)})
            if shape.category not in maps:
                maps[shape.category] = _maps(shape, seen)
        if report:
            report("projecting", done, len(shapes))
    summary = _summarise(records, sigmas)
    record = {
        "study": "sigma",
        "version": __version__,
        "settings": {
            "part": part,
            "views": views,
            "seed": seed,
            "points": settings.points,
            "mask": f"{SIZE}x{SIZE}",
            "sigma_sq": list(sigmas),
        },
        "convention": {
            "sigma_sq": f"px^2 of the {SIZE}x{SIZE} mask",
            "l1": "|silhouette - mask|, mean over pixels, views and shapes; the sum of missing and stray",
            "missing": "what the silhouette lacks of the mask; stray: what it has beyond it",
        },
        "summary": summary,
        "claims": _claims(summary, sigmas),
        "shapes": records,
    }
    return record, list(maps.values())


def mask_errors(seen: SeenShape, sigmas: Sequence[float]) -> dict[str, list[float]]:
    """Mean over pixels and views of what the true silhouette lacks, has too much, and both, for each sigma^2."""
    found = np.zeros((2, len(sigmas)))
    for view in seen.views:
        mask = view.mask.astype(np.float64) / 255.0
        for k, sigma_sq in enumerate(sigmas):
            over = silhouette_of(seen.target, view.camera, sigma_sq) - mask
            found[:, k] += np.maximum(-over, 0.0).mean(), np.maximum(over, 0.0).mean()
    found /= len(seen.views)
    return {"missing": found[0].tolist(), "stray": found[1].tolist(), "l1": found.sum(0).tolist()}


def _maps(shape: Shape, seen: SeenShape) -> Projections:
    view = seen.views[0]
    maps = {f"sigma^2 {sigma_sq:g}": silhouette_of(seen.target, view.camera, sigma_sq) for sigma_sq in SHOWN}
    return Projections(shape.name, view.mask.astype(np.float32) / 255.0, {**_discrete_maps(seen, view.camera), **maps})


def _discrete_maps(seen: SeenShape, camera: Camera) -> dict[str, NDArray[np.float32]]:
    """The two projections of the paper's figure that are not ours: points rounded to pixels, and Lin et al.'s depth map.

    Of the latter the nearest point that shows is white and the furthest grey.
    """
    pixels, depth = (torch.as_tensor(values).unsqueeze(0) for values in camera.project(seen.target))
    valid = depth > NEAR
    rounded = discrete_mask(pixels, valid, camera.height, camera.width)
    shown, hit = discrete_depth(pixels, depth, valid, camera.height, camera.width)
    near, far = shown[hit].min(), shown[hit].max()
    grey = torch.where(hit, 1.0 - 0.6 * (shown - near) / (far - near).clamp_min(1e-9), 0.0)
    maps = {"discretised": rounded, f"Lin et al., U = {UPSAMPLING}": grey}
    return {name: found[0].numpy().astype(np.float32) for name, found in maps.items()}


def _summarise(records: list[dict[str, Any]], sigmas: Sequence[float]) -> dict[str, Any]:
    """Means over the shapes of each category and of all; the best sigma^2, and how much worse the paper's is."""
    summary = {}
    for category in [*dict.fromkeys(record["category"] for record in records), "all"]:
        own = [record for record in records if category in ("all", record["category"])]
        means = {key: np.mean([record[key] for record in own], axis=0) for key in ("l1", "missing", "stray")}
        best = int(means["l1"].argmin())
        paper = 0.4 if category == "all" else PAPER.get(category)
        at_paper = None if paper is None else float(np.interp(np.log(paper), np.log(sigmas), means["l1"]))
        summary[category] = {
            "shapes": len(own),
            **{key: value.tolist() for key, value in means.items()},
            "best": sigmas[best],
            "l1_at_best": float(means["l1"][best]),
            "paper": paper,
            "l1_at_paper": at_paper,
        }
    return summary


def _claims(summary: dict[str, Any], sigmas: Sequence[float]) -> list[dict[str, Any]]:
    """What the paper says of sigma^2, whether it holds here, and the figures that say so."""
    named = {name: own for name, own in summary.items() if own["paper"] is not None and name != "all"}
    best = ", ".join(f"{name} {own['best']:g} (the paper's {own['paper']:g})" for name, own in named.items())
    every = summary["all"]
    claims = [
        {
            "claim": "a small sigma^2 leaves holes, a large one fills what is empty",
            "holds": bool(np.all(np.diff(every["missing"]) < 0.0) and np.all(np.diff(every["stray"]) > 0.0)),
            "found": f"from {sigmas[0]:g} to {sigmas[-1]:g} px^2 "
            f"missing {every['missing'][0]:.4f} to {every['missing'][-1]:.4f}, "
            f"stray {every['stray'][0]:.4f} to {every['stray'][-1]:.4f}",
        },
        {
            "claim": "the paper's sigma^2 is within a factor of two of the best in every category",
            "holds": all(0.5 <= own["best"] / own["paper"] <= 2.0 for own in named.values()),
            "found": best,
        },
    ]
    if "airplane" in named and len(named) > 1:
        others = [own["best"] for name, own in named.items() if name != "airplane"]
        nearest = min(sigmas, key=lambda sigma_sq: abs(np.log(sigma_sq / every["paper"])))
        claims.append(
            {
                "claim": "aeroplanes want a smaller sigma^2 than chairs and cars",
                "holds": all(named["airplane"]["best"] < other for other in others),
                "found": best,
            }
        )
        claims.append(
            {
                "claim": f"{every['paper']:g} is best for all categories together",
                "holds": every["best"] == nearest,
                "found": f"{every['best']:g} over all {every['shapes']} shapes",
            }
        )
    return claims
