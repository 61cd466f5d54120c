"""Small data sets in the layouts people have, pictured by each layout's own formulas, and how to
judge what is read back.

Every formula follows the definition of its data set, in the terms used there, independently of the
program's cameras. The vertices are moved into the frame of the camera, not the camera.
"""

import json
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from tests.io.test_shapes import binvox_bytes
from tests.scenes import about
from tso_cli import View
from tso_cli.datasets.items import ObjectItem
from tso_cli.evaluation.footprint import Solid, window_iou
from tso_cli.geometry.camera import Camera
from tso_cli.geometry.points import farthest_point_sample, sample_surface
from tso_cli.io.images import write_image
from tso_cli.io.meshes import Mesh, read_mesh
from tso_cli.io.shipped import examples_folder
from tso_cli.render.rays import RayScene, render_view

CHAIR = "03001627"
ANGLES = ((30.0, 20.0), (-110.0, -10.0), (165.0, 35.0))


@cache
def lopsided() -> Mesh:
    """A shipped chair with a small one beside it, so that no mirrored or turned view looks the
    same; unit diagonal, centred.
    """
    mesh = read_mesh(examples_folder() / "meshes/chair/kfurn_chair.ply")
    small = 0.45 * mesh.vertices + np.array([0.45, 0.1, 0.3])
    vertices = np.concatenate([mesh.vertices, small])
    low, high = vertices.min(0), vertices.max(0)
    vertices = (vertices - (low + high) / 2) / np.linalg.norm(high - low)
    return Mesh(vertices, np.concatenate([mesh.faces, mesh.faces + len(mesh.vertices)]))


@cache
def lopsided_points() -> np.ndarray:
    """1,024 points of it."""
    samples = sample_surface(lopsided().vertices, lopsided().faces, 4096, np.random.default_rng(0))
    return samples[farthest_point_sample(samples, 1024)]


def pictured(
    vertices: np.ndarray, faces: np.ndarray, focal: float, size: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """Image and mask (0, 255) of vertices that are in OpenCV camera axes already; the optical axis
    in the middle.
    """
    width, height = size
    K = np.array([[focal, 0.0, (width - 1) / 2], [0.0, focal, (height - 1) / 2], [0.0, 0.0, 1.0]])
    view = render_view(
        RayScene(Mesh(vertices, faces)), Camera(K, np.eye(3), np.zeros(3), width, height)
    )
    return view.image, view.mask


def write_cut_out(path: Path, vertices: np.ndarray, focal: float, size: int) -> np.ndarray:
    """Write a square picture of the object, with its mask as the alpha channel; the mask is also
    returned.
    """
    image, mask = pictured(vertices, lopsided().faces, focal, (size, size))
    write_image(path, np.dstack([np.where(mask[..., None] > 0, image, 0), mask]))
    return mask


def agreement(item: ObjectItem) -> float:
    """The smallest IoU of the target with the mask over all views."""
    points, values = item.target(), []
    assert points.dtype == np.float32
    assert points.shape[1] == 3
    for view in item.views:
        image, mask = view.load()
        assert image.dtype == np.uint8
        assert mask.dtype == np.float32
        assert image.shape == (view.camera.height, view.camera.width, 3) == (*mask.shape, 3)
        values.append(window_iou(Solid(points.astype(np.float64)), View(mask, view.camera)))
    return min(values)


def agreement_of_surface(item: ObjectItem, mesh: Mesh) -> float:
    """The smallest IoU of the masks with what the cameras of the item see of ``mesh``, which is in
    the frame of the item.
    """
    scene = RayScene(mesh)
    pairs = [
        (render_view(scene, view.camera).mask > 0, view.load()[1] > 0.5) for view in item.views
    ]
    return min((seen & mask).sum() / (seen | mask).sum() for seen, mask in pairs)


# The CAPNet authors' ShapeNet


def authors_points(points: np.ndarray, azimuth: float, elevation: float) -> np.ndarray:
    """A cloud in the axes X of the authors' code: row = 120 X_x / |X_z| + 32, column = 120 X_y /
    |X_z| + 32.
    """
    a, b, c = points.T
    p = np.stack([-b, -c, a])
    return (about("y", elevation) @ about("x", azimuth) @ p).T - np.array([0.0, 0.0, 2.0])


def write_shapenet(
    root: Path,
    models: tuple[str, ...] = ("abc",),
    size: int = 64,
    clouds: str = "ShapeNet_pcl",
    columns: int = 4,
) -> Path:
    for model in models:
        folder = root / "ShapeNet_rendered" / CHAIR / model
        folder.mkdir(parents=True)
        rows = []
        for k, (azimuth, elevation) in enumerate(ANGLES):
            x = authors_points(lopsided().vertices, azimuth, elevation)
            mask = write_cut_out(
                folder / f"render_{k}.png",
                x[:, [1, 0, 2]] * [1.0, 1.0, -1.0],
                120.0 * size / 64,
                size,
            )
            depth = np.where(mask > 0, round(2.0 / 10.0 * 65535), 65535).astype(np.uint16)
            Image.fromarray(depth).save(folder / f"depth_{k}.png")
            (folder / f"camera_{k}.mat").write_bytes(b"MATLAB 5.0 MAT-file, never read")
            rows.append(" ".join(map(str, (int(azimuth), int(elevation), 0, 2.0)[:columns])))
        (folder / "view.txt").write_text("\n".join(rows) + "\n")
    write_clouds(root, *models, folder=clouds)
    return root


# 3D-R2N2


def blender_points(vertices: np.ndarray) -> np.ndarray:
    """The axes an .obj with y up gets in Blender, z up."""
    x, y, z = vertices.T
    return np.stack([x, -z, y], axis=1)


def through_blender_camera(points: np.ndarray, matrix: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Points [N, 3] of Blender's world in OpenCV axes of the camera, whose own axes are x right, y
    up, -z forward.
    """
    local = (points - place) @ matrix
    return local * np.array([1.0, -1.0, -1.0])


def write_r2n2(
    root: Path,
    models: tuple[str, ...] = ("abc",),
    size: int = 64,
    listed: bool = True,
    rotation: float = 0.0,
) -> Path:
    for model in models:
        folder = root / CHAIR / model / "rendering"
        folder.mkdir(parents=True)
        rows, names = [], []
        for k, (azimuth, elevation) in enumerate(ANGLES):
            ratio = 0.7 + 0.1 * k
            # The renderer turns an empty object, by Euler angles (-rotation, -elevation, -azimuth)
            # in the order x, y, z, that carries the camera at (1.75 ratio, 0, 0), itself turned by
            # 90 degrees about z and then y.
            carrier = about("z", -azimuth) @ about("y", -elevation) @ about("x", -rotation)
            matrix = carrier @ about("y", 90.0) @ about("z", 90.0)
            place = carrier @ np.array([1.75 * ratio, 0.0, 0.0])
            seen = through_blender_camera(blender_points(lopsided().vertices), matrix, place)
            names.append(f"{k:02d}.png")
            write_cut_out(folder / names[-1], seen, 35.0 / 32.0 * size, size)
            rows.append(f"{azimuth} {elevation} {rotation} {ratio} 25")
        (folder / "rendering_metadata.txt").write_text("\n".join(rows) + "\n")
        if listed:
            (folder / "renderings.txt").write_text("\n".join(names) + "\n")
    return root


def write_clouds(beside: Path, *models: str, folder: str = "ShapeNet_pcl") -> None:
    for model in models:
        (beside / folder / CHAIR / model).mkdir(parents=True)
        np.save(beside / folder / CHAIR / model / "pcl_1024_fps_trimesh.npy", lopsided_points())


def write_binvox(path: Path, in_the_middle: bool, side: int = 32) -> None:
    """The object as voxels the size of the file's scale, at the corner of the grid or (binvox -cb)
    in the middle of it.
    """
    mesh = lopsided()
    points = sample_surface(mesh.vertices, mesh.faces, 40000, np.random.default_rng(1))
    low, high = points.min(0), points.max(0)
    scale = float((high - low).max())
    corner = (low + high) / 2 - scale / 2 if in_the_middle else low
    index = np.clip(np.floor((points - corner) / scale * side), 0, side - 1).astype(int)
    grid = np.zeros((side, side, side), dtype=bool)
    grid[tuple(index.T)] = True
    path.parent.mkdir(parents=True)
    path.write_bytes(binvox_bytes(grid, " ".join(f"{value:.6f}" for value in low), f"{scale:.6f}"))


# Pix3D

PIX3D_SIZE = (88, 60)


def write_pix3d(root: Path, count: int = 3) -> list[dict[str, Any]]:
    """Photos of one model that is neither centred nor of any usual size; the entries are also
    returned.
    """
    for folder in ("img/chair", "mask/chair", "model/chair/IKEA_X"):
        (root / folder).mkdir(parents=True)
    vertices = 1.7 * lopsided().vertices + np.array([0.4, -0.3, 0.2])
    corners = "".join(f"v {x:.7f} {y:.7f} {z:.7f}\n" for x, y, z in vertices)
    faces = "".join(f"f {i} {j} {k}\n" for i, j, k in lopsided().faces + 1)
    (root / "model/chair/IKEA_X/model.obj").write_text(corners + faces)
    entries = []
    for k in range(count):
        rotation = about("x", 15.0) @ about("y", 40.0 + 110.0 * k) @ about("z", 6.0)
        shift = np.array([0.15, -0.1, 2.6]) - rotation @ np.array([0.4, -0.3, 0.2])
        focal = 30.0 + k
        # Blender's camera at the origin, turned by 180 degrees about y.
        seen = through_blender_camera(vertices @ rotation.T + shift, about("y", 180.0), np.zeros(3))
        image, mask = pictured(seen, lopsided().faces, focal / 32.0 * PIX3D_SIZE[0], PIX3D_SIZE)
        write_image(root / f"img/chair/{k:04d}.png", image)
        write_image(root / f"mask/chair/{k:04d}.png", mask)
        files = {
            "img": f"img/chair/{k:04d}.png",
            "mask": f"mask/chair/{k:04d}.png",
            "model": "model/chair/IKEA_X/model.obj",
        }
        camera = {"rot_mat": rotation.tolist(), "trans_mat": shift.tolist(), "focal_length": focal}
        size = {"category": "chair", "img_size": list(PIX3D_SIZE), "bbox": [0, 0, *PIX3D_SIZE]}
        entries.append(
            {
                **files,
                **camera,
                **size,
                "truncated": False,
                "occluded": False,
                "slightly_occluded": False,
            }
        )
    write_entries(root, entries)
    return entries


def write_entries(root: Path, entries: Any) -> None:
    (root / "pix3d.json").write_text(json.dumps(entries))
