"""What the depth maps of a scene hold, and the move that depends on it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

from ..cloud.cloud import ControlledCloud
from ..diagnosis.depth_kinds import along_z, fitted, without_depth
from ..diagnosis.depth_map import wrong_maps
from ..diagnosis.depth_noise import without_noise
from ..diagnosis.findings import Finding
from ..geometry.arrays import Array
from ..geometry.depth_kind import FITTED, DepthKind
from ..geometry.view import View
from ..optimisation.config import Settings
from ..optimisation.learned_start import beginning
from ..optimisation.optimise import weigh
from ..optimisation.problem import prepare
from ..pose.asked import Asked
from ..pose.move import Move
from ..prior import LearnedPrior, named_prior
from .clock import Clock
from .scene import RefineScene

Find = Callable[[RefineScene], Move]
# With these moves the cloud may be given anywhere. Where it is given it says nothing of a map.
ANYWHERE = ("pose", "similarity")
# How often a map is fitted to where the learned prior moves the cloud.
FITS = 2


def move_with_maps(
    scene: RefineScene, points: Array, settings: Settings, find: Find
) -> tuple[Move, RefineScene]:
    """What moves as one, and the scene after it, without maps that turn out to be wrong.

    ``find`` finds the move of a scene. ``points`` [N, 3] are of the cloud. All maps are along z
    then, except those that are known up to two numbers.
    """
    if not settings.smooth:
        # Depth maps are refused later.
        move = find(scene)
        return move, scene.after(move)
    scene = scene.with_views(*without_noise(scene.views))
    return _placed(_tested(scene, points, settings.move, find), find, FITTED)


def fit_maps(
    scene: RefineScene, cloud: ControlledCloud, settings: Settings, clock: Clock
) -> RefineScene:
    """The scene with all maps along z, after a move.

    Maps that are known up to two numbers are fitted to the cloud where the learned prior moves it
    by the masks, then where it moves it by masks and maps. Fitted to the start, which is of another
    shape, they would pull back to it.
    """
    held_back = [view.depth is not None and view.depth_kind in FITTED for view in scene.views]
    if not any(held_back) or not settings.smooth:
        return scene
    prior = named_prior(settings.prior)
    if prior is None or not settings.steps:
        return scene.with_views(*fitted(cloud.control_points, scene.views))
    fitted_views = [
        without_depth(view) if is_held else view
        for view, is_held in zip(scene.views, held_back, strict=True)
    ]
    points, findings = cloud.control_points, list[Finding]()
    for _ in range(FITS):
        points = clock.attempt(
            "move", partial(_begun, cloud, fitted_views, settings, prior), points
        )
        fitted_views, findings = fitted(points, scene.views)
    return scene.with_views(fitted_views, findings)


def _begun(
    cloud: ControlledCloud, views: Sequence[View], settings: Settings, prior: LearnedPrior
) -> Array:
    """[N, 3], the control points where the ``prior`` moves them by the ``views``."""
    weighed = weigh(prepare(cloud, views, replace(settings, symmetry="none")), settings)
    return cloud.denormalise(beginning(weighed.problem, weighed.weights, prior).points)


def _tested(scene: RefineScene, points: Array, freedom: Asked, find: Find) -> RefineScene:
    """The scene without the maps of kind "auto" that are something else; the others are along z.

    A map that is wrong where the cloud is given may be wrong because the cloud is out of place. It
    is tested again where the masks alone put the cloud.
    """
    if all(view.depth is None or view.depth_kind != "auto" for view in scene.views):
        return scene
    findings = [] if freedom in ANYWHERE else wrong_maps(points, scene.views)
    if findings or freedom in ANYWHERE:
        _, placed = _placed(scene, find, ("auto", *FITTED))
        findings = wrong_maps(points, placed.views, any_size=freedom == "similarity")
    wrong = [finding.views[0] for finding in findings]
    views = [
        without_depth(view)
        if number in wrong
        else replace(view, depth_kind="z" if view.depth_kind == "auto" else view.depth_kind)
        for number, view in enumerate(scene.views)
    ]
    return scene.with_views(views, findings)


def _placed(
    scene: RefineScene, find: Find, held_back: Sequence[DepthKind]
) -> tuple[Move, RefineScene]:
    """The move without the maps of some kinds, and the scene after it, with these maps again."""
    views_before = scene.views
    bare = [without_depth(view) if view.depth_kind in held_back else view for view in views_before]
    scene = scene.with_views([along_z(view) for view in bare])
    move = find(scene)
    placed = scene.after(move)
    views = [
        replace(view, depth=before.depth / move.size, depth_kind=before.depth_kind)
        if before.depth is not None and before.depth_kind in held_back
        else view
        for before, view in zip(views_before, placed.views, strict=True)
    ]
    return move, placed.with_views(views)
