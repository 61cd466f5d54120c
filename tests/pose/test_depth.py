"""A depth map says how far away a cloud is, and so how large."""

from dataclasses import replace

import numpy as np
import pytest

from tests.scenes import EXAMPLES, about
from tso_cli import Camera, View, refine
from tso_cli.cloud.cloud import Cloud
from tso_cli.evaluation.metrics import chamfer
from tso_cli.io.meshes import read_mesh
from tso_cli.pose.causes import find_move
from tso_cli.pose.misfit import DepthMisfit, DepthSurface
from tso_cli.pose.placement import UNKNOWNS, Placements
from tso_cli.pose.target import Target
from tso_cli.render.folder import ground_truth, normalise
from tso_cli.render.rays import RayScene
from tso_cli.render.settings import RenderSettings
from tso_cli.render.viewpoints import look_at

CAMERA = Camera.canonical(64, 64)
BALL = np.random.default_rng(0).normal(size=(400, 3))
BALL *= 0.5 / np.linalg.norm(BALL, axis=1, keepdims=True)


def _ball():
    """A ball of diameter 1 and its depth map, exact at the pixels."""
    rows, columns = np.indices((64, 64))
    rays = np.stack([columns, rows, np.ones((64, 64))], -1) @ np.linalg.inv(CAMERA.K).T
    middle = CAMERA.t
    a, b, c = (rays**2).sum(-1), rays @ middle, middle @ middle - 0.25
    inside = b**2 - a * c
    depth = np.where(inside > 0.0, (b - np.sqrt(np.maximum(inside, 0.0))) / a, 0.0)
    return View(np.float32(inside > 0.0), CAMERA, depth=depth)


@pytest.fixture(scope="module")
def chair():
    """Samples of a chair, and a view of it with its depth map."""
    mesh = normalise(read_mesh(EXAMPLES / "meshes/chair/q19_OfficeChair.ply"))
    points, _ = ground_truth(mesh, RenderSettings(samples=2048), np.random.default_rng(0))
    camera = look_at(30.0, 15.0, 2.4, (128, 128))
    hits = RayScene(mesh).cast(camera, np.arange(128.0), np.arange(128.0))
    depth = np.where(hits["hit"], hits["depth"], 0.0)
    return points, View(np.float32(hits["hit"]), camera, depth=depth)


def _move(points, view, asked="similarity", keep="auto"):
    return find_move(Cloud(points, "points").controlled().body, [view], asked, keep)


def test_the_visible_side_of_a_cloud_on_the_surface_misses_nothing_and_of_a_shifted_one_most():
    surface = DepthSurface.of(Target.of(_ball(), 64))
    there = Placements.unmoved()
    # One point in each block at least.
    many = np.concatenate([BALL @ about("y", 7.0 * turn).T for turn in range(30)])
    misfit = DepthMisfit(many, [surface], 1.0)
    shifted = replace(there, t=0.2 * CAMERA.R[2:3])
    # Points at the rim, where the surface ends, have no distance.
    assert misfit(there).value[0] < 0.1
    assert misfit(shifted).value[0] > 0.8
    assert surface.farther(many, there)[0] == pytest.approx(1.0, abs=0.005)
    nearer = replace(there, t=-0.2 * CAMERA.R[2:3])
    assert surface.farther(many, nearer)[0] > 1.08


def test_the_gradient_of_the_depth_misfit_is_half_its_slope():
    surface = DepthSurface.of(Target.of(_ball(), 64))
    misfit = DepthMisfit(BALL, [surface], 3.0)
    step = np.zeros((1, UNKNOWNS))
    step[:, :7] = [0.1, -0.2, 0.05, 0.02, -0.03, 0.05, 0.05]
    at = Placements.unmoved().stepped(step)
    gradient = misfit(at).gradient[0]
    for column, step in enumerate(1e-7 * np.eye(UNKNOWNS)):
        after, before = (misfit(at.stepped(s[None])).value[0] for s in (step, -step))
        assert gradient[column] == pytest.approx(-(after - before) / 4e-7, rel=0.02, abs=0.02)


def test_one_view_with_a_depth_map_finds_size_and_distance_in_other_units(chair):
    points, view = chair
    floor = 2.0 * chamfer(points[::2], points[1::2]).chamfer
    middle = points.mean(0)
    for size in (1.05, 30.0):
        wrong = size * (points - middle) @ about("y", 6.0).T + size * middle
        move = _move(wrong, view)
        assert move.keep is None
        assert move.size == pytest.approx(1.0 / size, rel=0.02)
        assert chamfer(move.apply(wrong), points).chamfer < floor
        # The mask alone cannot tell.
        assert _move(wrong, replace(view, depth=None)).keep is not None


def test_by_default_a_right_shape_with_a_depth_map_moves_and_a_wrong_one_stays(chair):
    points, view = chair
    wrong = points @ about("y", 8.0).T
    result = refine(wrong, view)
    assert result.move.kind in ("shift", "pose", "similarity")
    assert chamfer(result.points, points).chamfer < 0.2 * chamfer(wrong, points).chamfer
    other = normalise(read_mesh(EXAMPLES / "meshes/chair/kfurn_chair.ply"))
    another, _ = ground_truth(other, RenderSettings(samples=2048), np.random.default_rng(0))
    assert _move(another, view, "auto").kind == "nothing"
