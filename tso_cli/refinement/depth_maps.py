"""What the depth maps of a scene hold, and the move that depends on it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

from ..cloud.cloud import ControlledCloud
from ..diagnosis.depth_kinds import along_z, fitted, without_depth
from ..diagnosis.depth_map import wrong_maps
from ..geometry.arrays import Array
from ..geometry.depth_kind import FITTED, DepthKind
from ..optimisation.learned_start import beginning
from ..optimisation.optimise import weigh
from ..optimisation.problem import prepare
from ..optimisation.settings import Settings
from ..pose.asked import Asked
from ..pose.move import Move
from ..prior import named_prior
from .clock import Clock
from .scene import RefineScene

Find = Callable[[RefineScene], Move]
# With these moves the cloud may be given anywhere. Where it is given it says nothing of a map.
ANYWHERE = ("pose", "similarity")


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
    return _placed(_tested(scene, points, settings.move, find), find, FITTED)


def fit_maps(
    scene: RefineScene, cloud: ControlledCloud, settings: Settings, clock: Clock
) -> RefineScene:
    """The scene with all maps along z, after a move.

    Maps that are known up to two numbers are fitted to the cloud where the learned prior moves it
    by the masks. Fitted to the start, which is of another shape, they would pull back to it.
    """
    held_back = [view.depth is not None and view.depth_kind in FITTED for view in scene.views]
    if not any(held_back) or not settings.smooth:
        return scene
    points, prior = cloud.control_points, named_prior(settings.prior)
    if prior is not None and settings.steps:
        bare = [
            without_depth(view) if held else view
            for view, held in zip(scene.views, held_back, strict=True)
        ]
        weighed = weigh(prepare(cloud, bare, replace(settings, symmetry="none")), settings)
        of_start = weighed.problem, weighed.weights, prior
        if begun := clock.attempt("move", partial(beginning, *of_start), None):
            points = cloud.denormalise(begun.points)
    views, found = fitted(points, scene.views)
    return scene.with_views(views, found)


def _tested(scene: RefineScene, points: Array, asked: Asked, find: Find) -> RefineScene:
    """The scene without the maps of kind "auto" that are something else; the others are along z.

    A map that is wrong where the cloud is given may be wrong because the cloud is out of place. It
    is tested again where the masks alone put the cloud.
    """
    if all(view.depth is None or view.depth_kind != "auto" for view in scene.views):
        return scene
    found = [] if asked in ANYWHERE else wrong_maps(points, scene.views)
    if found or asked in ANYWHERE:
        _, placed = _placed(scene, find, ("auto", *FITTED))
        found = wrong_maps(points, placed.views, any_size=asked == "similarity")
    wrong = [one.views[0] for one in found]
    views = [
        without_depth(view)
        if number in wrong
        else replace(view, depth_kind="z" if view.depth_kind == "auto" else view.depth_kind)
        for number, view in enumerate(scene.views)
    ]
    return scene.with_views(views, found)


def _placed(
    scene: RefineScene, find: Find, held_back: Sequence[DepthKind]
) -> tuple[Move, RefineScene]:
    """The move without the maps of some kinds, and the scene after it, with these maps again."""
    given = scene.views
    bare = [without_depth(view) if view.depth_kind in held_back else view for view in given]
    scene = scene.with_views([along_z(view) for view in bare])
    move = find(scene)
    placed = scene.after(move)
    views = [
        replace(view, depth=before.depth / move.size, depth_kind=before.depth_kind)
        if before.depth is not None and before.depth_kind in held_back
        else view
        for before, view in zip(given, placed.views, strict=True)
    ]
    return move, placed.with_views(views)
