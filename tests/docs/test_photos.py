"""The example with photos, on pictures made here: the photos are not in the repository."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

from tso_cli.io.images import write_image

PATH = Path(__file__).parents[2] / "examples" / "temple_ring.py"


@pytest.fixture(scope="module")
def script():
    spec = importlib.util.spec_from_file_location("temple_ring", PATH)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def photos(tmp_path_factory, script):
    """Seven pictures of an ellipsoid 16 cm long above a dim stand, from a half circle around it."""
    folder = tmp_path_factory.mktemp("photos")
    rng = np.random.default_rng(0)
    middle, half = script.BOX.mean(0), np.ptp(script.BOX, 0) / 2.0
    ball = rng.standard_normal((60_000, 3))
    surface = middle + half * ball / np.linalg.norm(ball, axis=1, keepdims=True)
    K = np.array([[380.0, 0.0, 79.5], [0.0, 380.0, 59.5], [0.0, 0.0, 1.0]])
    lines = ["7"]
    for i, angle in enumerate(np.linspace(0.0, np.pi, 7)):
        c, s = np.cos(angle), np.sin(angle)
        R = np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]])
        t = np.array([0.0, 0.0, 0.55]) - R @ middle
        camera = surface @ R.T + t
        column, row = (
            ((camera[:, :2] / camera[:, 2:]) @ K[:2, :2].T + K[:2, 2]).round().astype(int).T
        )
        picture = np.zeros((120, 160, 3), np.uint8)
        picture[100:] = 50
        picture[row, column] = 200
        picture[58:62, 78:82] = 0
        write_image(folder / f"ball{i}.png", picture)
        lines.append(" ".join([f"ball{i}.png", *(str(n) for n in (*K.ravel(), *R.ravel(), *t))]))
    lines.append(lines[-1].replace("ball6", "elsewhere"))
    (folder / "ball_par.txt").write_text("\n".join(lines) + "\n")
    return folder


def test_a_mask_is_the_largest_bright_thing_without_holes(script):
    picture = np.zeros((60, 80, 3), np.uint8)
    picture[40:] = 55
    picture[10:50, 20:60, 1] = 180
    picture[25:30, 35:45] = 0
    picture[5:9, 70:75] = 255
    mask = script.mask_of(picture)
    assert mask[27, 40]
    assert not mask[7, 72]
    assert not mask[55, 5]
    assert mask.sum() == pytest.approx(40 * 40, rel=0.05)


@pytest.mark.slow
def test_photos_become_masks_a_camera_file_and_a_start_that_four_of_them_improve_for_the_others(
    script, photos, tmp_path, capsys
):
    from tso_cli import RefineConfig, refine
    from tso_cli.io.clouds import read_cloud, write_cloud

    script.prepare(photos, tmp_path)
    views = script.read_views(tmp_path)
    assert [view.name for view in views] == [f"ball{i}" for i in range(7)]
    used = script.spread(views, 4)
    assert [view.name for view in used] == ["ball0", "ball2", "ball4", "ball6"]
    others = [view for view in views if view not in used]
    start = read_cloud(tmp_path / "start.ply").points
    refined = refine(start, used, config=RefineConfig(steps=45, symmetry="none")).points
    before, after = script.judged(start, others), script.judged(refined, others)
    assert after["iou"] > before["iou"] + 0.05
    assert after["beside"] < before["beside"]
    write_cloud(tmp_path / "refined.ply", refined)
    capsys.readouterr()
    script.judge(tmp_path, tmp_path / "refined.ply", [view.name for view in used])
    assert f"IoU {after['iou']:.3f}, worst {after['worst_iou']:.3f}" in capsys.readouterr().out


def test_a_point_beside_a_mask_or_outside_the_picture_is_not_inside(script, photos, tmp_path):
    script.prepare(photos, tmp_path)
    view = script.read_views(tmp_path)[0]
    middle = script.BOX.mean(0)
    points = np.array([middle, middle + [0.0, 0.1, 0.0], middle + [5.0, 0.0, 0.0]])
    assert script.inside(points, view).tolist() == [True, False, False]
