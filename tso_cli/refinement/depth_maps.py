"""What the depth maps of a scene hold, and the move that depends on it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from ..diagnosis.depth_map import settled, without_depth, wrong_maps
from ..geometry.arrays import Array
from ..geometry.view import FITTED, DepthKind
from ..pose.asked import Asked
from ..pose.move import Move
from .scene import RefineScene

Find = Callable[[RefineScene], Move]
# With these moves the cloud may be given anywhere. Where it is given it says nothing of a map.
ANYWHERE = ("pose", "similarity")


def move_and_settle(
    scene: RefineScene, points: Array, asked: Asked, find: Find
) -> tuple[Move, RefineScene]:
    """What moves as one, and the scene after it, with all depth maps along z.

    ``find`` finds the move of a scene, of the kind that was ``asked`` for. Maps that are known up
    to two numbers are fitted to the cloud, of ``points`` [N, 3], where the masks alone put it.
    """
    scene = _tested(scene, points, asked, find)
    move, placed = _placed(scene, points, find, FITTED)
    return move, placed.with_views(*settled(points, placed.views))


def _tested(scene: RefineScene, points: Array, asked: Asked, find: Find) -> RefineScene:
    """The scene without the maps of kind "auto" that are something else; the others are along z.

    A map that is wrong where the cloud is given may be wrong because the cloud is out of place. It
    is tested again where the masks alone put the cloud.
    """
    if all(view.depth is None or view.depth_kind != "auto" for view in scene.views):
        return scene
    found = [] if asked in ANYWHERE else wrong_maps(points, scene.views)
    if found or asked in ANYWHERE:
        _, placed = _placed(scene, points, find, ("auto", *FITTED))
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
    scene: RefineScene, points: Array, find: Find, held_back: Sequence[DepthKind]
) -> tuple[Move, RefineScene]:
    """The move without the maps of some kinds, and the scene after it, with these maps again."""
    given = scene.views
    bare = [without_depth(view) if view.depth_kind in held_back else view for view in given]
    scene = scene.with_views(settled(points, bare)[0])
    move = find(scene)
    placed = scene.after(move)
    views = [
        replace(view, depth=before.depth / move.size, depth_kind=before.depth_kind)
        if before.depth is not None and before.depth_kind in held_back
        else view
        for before, view in zip(given, placed.views, strict=True)
    ]
    return move, placed.with_views(views)
