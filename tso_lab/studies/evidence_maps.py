"""Depth maps that hold something else than depth along z, and whether this is noticed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from tso_cli.diagnosis.depth_map import Contents
from tso_cli.diagnosis.findings import OF_DEPTH_MAPS
from tso_cli.geometry.arrays import Array
from tso_cli.geometry.camera import intrinsics
from tso_cli.geometry.view import View
from tso_cli.refinement import RefineResult
from tso_cli.render.rays import RayScene, render_view
from tso_cli.render.viewpoints import fitting_distance

from .cases import Case
from .evidence_alterations import Alter, Rng, Truth, exact_depth, unaltered
from .refining import Variant

# Of the mask's longer side, by which a map is shifted.
SHIFT = 0.1
DEPTH = "depth"
FIELDS_OF_VIEW = (30, 60, 90)


class Map(NamedTuple):
    """What a map ``holds``, and what that should be called; ``fov`` : of its camera, degrees."""

    holds: str
    called: Contents
    fov: int | None = None


MAPS = {
    **{name: Map(name, "inverse") for name in ("1 / depth", "a / depth + b")},
    **{name: Map(name, "affine") for name in ("depth from 0 to 1", "a depth + b")},
    "millimetres": Map("millimetres", "unit"),
    **{f"along the ray, {fov} degrees": Map("along the ray", "ray", fov) for fov in FIELDS_OF_VIEW},
    **{name: Map(name, "unrelated") for name in ("another object", "flipped", "shifted by 10 %")},
}


def rows() -> dict[str, tuple[Alter, Variant]]:
    """The mask, the right map, and each wrong map, which is tested."""
    table: dict[str, Alter] = {}
    for fov in (None, *FIELDS_OF_VIEW):
        seen = f", {fov} degrees" if fov else ""
        table[f"mask{seen}"] = partial(with_fov, fov=fov) if fov else unaltered
        table[f"right map{seen}"] = partial(with_map, holds=DEPTH, fov=fov)
    for name, (holds, _, fov) in MAPS.items():
        table[name] = partial(with_map, holds=holds, fov=fov)
    return {label: (alter, Variant()) for label, alter in table.items()}


def ignored(result: RefineResult, label: str) -> float:
    """1 if a map was left out."""
    return float(bool(_wrong(result)))


def named(result: RefineResult, label: str) -> float:
    """1 if it was said what the map of a row holds."""
    wrong = MAPS.get(label)
    return float(wrong is not None and f"depth-{wrong.called}" in _wrong(result))


def _wrong(result: RefineResult) -> set[str]:
    return {one.name for one in result.findings if one.name in OF_DEPTH_MAPS} - {"depth-fitted"}


def with_fov(case: Case, truth: Truth, rng: Rng, fov: float) -> Case:
    """The first view from so near that the object fills a picture of this angle, degrees."""
    view = case.views[0]
    focal = view.camera.width / 2.0 / np.tan(np.radians(fov) / 2.0)
    camera = replace(view.camera, K=intrinsics(focal, view.camera.width, view.camera.height))
    distance = fitting_distance(truth.mesh.vertices, camera, least=0.0)
    camera = replace(camera, t=np.array([0.0, 0.0, distance]))
    mask = render_view(truth.scene, camera).mask.astype(np.float32) / 255.0
    return replace(case, views=(replace(view, mask=mask, camera=camera),))


def with_map(
    case: Case, truth: Truth, rng: Rng, holds: str, fov: float | None = None
) -> Case | None:
    """The first view with a map that ``holds`` something, of a kind that tso has to find out.

    None where the map is unknown on the whole mask.
    """
    seen = case if fov is None else with_fov(case, truth, rng, fov)
    view = seen.views[0]
    values = _held(view, holds, truth, rng)
    values = np.where(np.isfinite(values) & (values > 0.0), values, 0.0)
    if not values[view.inside].any():
        return None
    return replace(seen, views=(replace(view, depth=values, depth_kind="auto"),))


def _held(view: View, holds: str, truth: Truth, rng: Rng) -> Array:
    """[H, W], the numbers of a map of the view."""
    depth = exact_depth(truth.scene, view.camera)
    depth = np.where(np.isfinite(depth), depth, np.nan)
    low, high = np.nanmin(depth), np.nanmax(depth)
    scale, shift = 10.0 ** rng.uniform(-1.0, 3.0), rng.uniform(0.5, 1.0)
    left, top, right, bottom = view.box()
    across = round(SHIFT * max(right - left, bottom - top))
    numbers: dict[str, Callable[[], Array]] = {
        DEPTH: lambda: depth,
        "1 / depth": lambda: 1.0 / depth,
        "a / depth + b": lambda: scale * (1.0 / depth - (2.0 * shift - 1.0) / high),
        "depth from 0 to 1": lambda: (depth - low) / (high - low),
        "a depth + b": lambda: scale * (depth - shift * low),
        "millimetres": lambda: 1000.0 * depth,
        "along the ray": lambda: depth * view.camera.ray_lengths(*np.indices(depth.shape)),
        # The shape on its side stands for another object.
        "another object": lambda: exact_depth(_lying(truth), view.camera),
        "flipped": lambda: depth[:, ::-1],
        "shifted by 10 %": lambda: np.roll(depth, across, 1),
    }
    return numbers[holds]()


def _lying(truth: Truth) -> RayScene:
    return RayScene(replace(truth.mesh, vertices=truth.mesh.vertices[:, [1, 2, 0]]))
