"""A mesh whose ends differ by its texture alone gets its pose from the photo."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image
from scipy.ndimage import binary_closing

from tests.readme import ROOT
from tests.scenes import about, example
from tso_cli.geometry.rotations import angle_between
from tso_cli.io.clouds import PointCloud, read_cloud
from tso_cli.io.views import ViewFiles
from tso_cli.scene.load import ONLY_SHOWN, load_points_scene

CAR = ROOT / "examples/meshes/car/qbasic_RaceCar.ply"
CAMERA = example("car").camera
TURNED = CAMERA.R @ about("y", 180.0)
SIDE = 64


def painted():
    """A picture whose columns go along a car: pale lamps in front, red ones at the back."""
    row, column = np.mgrid[0:SIDE, 0:SIDE] / (SIDE - 1.0)
    low = np.abs(row - 0.55) < 0.15
    ends = [low & (column > 0.9), low & (column < 0.1)]
    lamps = np.select([end[..., None] for end in ends], [[0.9, 0.9, 0.8], [0.8, 0.1, 0.1]], 0.4)
    grain = 0.2 * np.random.default_rng(0).standard_normal((SIDE, SIDE, 1))
    return Image.fromarray(np.uint8(255.0 * np.clip(lamps + grain, 0.0, 1.0)))


def places(mesh, points):
    """Texture coordinates of points: along the car, and up."""
    low, high = mesh.bounds[:, [2, 1]]
    return (points[:, [2, 1]] - low) / (high - low)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The car as car.glb and car.obj, its mask, and photos of it with its front on either side."""
    path = tmp_path_factory.mktemp("textured")
    mesh, picture = trimesh.load(CAR, process=False), painted()
    for suffix in ("glb", "obj"):
        material = trimesh.visual.material.SimpleMaterial(image=picture)
        material = material.to_pbr() if suffix == "glb" else material
        uv = places(mesh, mesh.vertices)
        visual = trimesh.visual.TextureVisuals(uv, material=material)
        one = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False, visual=visual)
        one.export(path / f"car.{suffix}")
    points = trimesh.sample.sample_surface(mesh, 200_000, seed=0)[0]
    (column, row), depth = (
        CAMERA.project(points)[0].round().astype(int).T,
        CAMERA.project(points)[1],
    )
    from_afar = np.argsort(-depth)
    column, row = column[from_afar], row[from_afar]
    seen = np.zeros((CAMERA.height, CAMERA.width), bool)
    seen[row, column] = True
    Image.fromarray(np.uint8(255 * binary_closing(seen, iterations=2))).save(path / "mask.png")
    light = 0.7 + 0.3 * points[from_afar, 1:2] / np.abs(points[:, 1]).max()
    for name in ("front", "back"):
        u, v = places(mesh, points[from_afar]).T
        u = u if name == "front" else 1.0 - u
        at = (np.stack([1.0 - v, u]) * (SIDE - 1e-6)).astype(int)
        photo = np.full((*seen.shape, 3), 255.0)
        photo[row, column] = light * np.asarray(picture)[tuple(at)]
        Image.fromarray(np.uint8(np.clip(photo, 0.0, 255.0))).save(path / f"{name}.png")
    return path


def fitted(folder, mesh, photo):
    files = ViewFiles([folder / "mask.png"], image=[folder / photo], focal=float(CAMERA.K[0, 0]))
    return load_points_scene(folder / mesh, files, fit=0).fitted


@pytest.mark.parametrize("mesh", ["car.glb", "car.obj"])
def test_the_photo_of_a_textured_mesh_tells_its_front_from_its_back(folder, mesh):
    front, back = (fitted(folder, mesh, name) for name in ("front.png", "back.png"))
    assert angle_between(front.camera.R, CAMERA.R) < 12.0
    assert angle_between(back.camera.R, TURNED) < 12.0
    assert front.sure


def test_without_its_texture_the_mask_alone_decides(folder, monkeypatch):
    monkeypatch.setattr(PointCloud, "paint", lambda cloud: None)
    with pytest.warns(UserWarning, match=ONLY_SHOWN):
        front, back = (fitted(folder, "car.glb", name) for name in ("front.png", "back.png"))
    assert (front.camera.R == back.camera.R).all()


def test_the_result_keeps_the_texture_of_its_mesh(folder, refine, monkeypatch):
    monkeypatch.chdir(folder)
    words = ("--camera", "fit", "--focal", str(CAMERA.K[0, 0]), "--steps", "0")
    run = refine("car.glb", "mask.png", *words, "--image", "back.png", "-o", "out.glb")
    assert ONLY_SHOWN not in run.err
    assert Path("out.glb").read_bytes() == Path("car.glb").read_bytes()
    run = refine("car.glb", "mask.png", *words, "--image", "back.png", "-o", "o.ply", "--overwrite")
    assert read_cloud("o.ply").colours() is None
    Path("lost.obj").write_bytes(Path("car.obj").read_bytes().replace(b"material.mtl", b"lost.mtl"))
    run = refine("lost.obj", "mask.png", *words, "--image", "back.png", "-o", "lost.ply")
    assert run.code == 0
    assert "the material file 'lost.mtl' is not in this folder or below" in run.err
    assert ONLY_SHOWN in run.err
