"""Ray casting: picture and mask of one mesh seen by one camera."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import TsoError
from ..geometry.camera import Camera
from ..geometry.points import Array
from ..io.meshes import GREY, Mesh

RAYS_ACROSS = 5
"""Rays across one pixel, 25 in all. Odd, since ties at half coverage would shift outlines."""
RAYS_AT_ONCE = 1 << 21
AMBIENT = 0.3
"""Brightness of a face parallel to the light."""


@dataclass(frozen=True, eq=False)
class RenderedView:
    """image [H, W, 3] uint8 on white, mask [H, W] uint8 (255 inside, 0 outside), and the camera of both."""

    image: NDArray[np.uint8]
    mask: NDArray[np.uint8]
    camera: Camera


class RayScene:
    """A mesh ready for ray casting, in single precision: normalise what lies far from the origin first.

    Raises TsoError if open3d, which casts the rays, is missing or cannot be loaded.
    """

    def __init__(self, mesh: Mesh) -> None:
        try:
            import open3d
        except (ImportError, OSError) as error:
            if isinstance(error.__cause__, KeyboardInterrupt):  # Ctrl-C during the import
                raise KeyboardInterrupt from None
            reason = " ".join(str(error).split())
            raise TsoError(
                f"rendering needs open3d ({reason}): pip install 'tso-cli[render]', "
                "and on Debian apt-get install libusb-1.0-0 libgl1 libegl1 libx11-6 libgomp1"
            ) from None
        self._o3d: Any = open3d
        self.mesh = mesh
        self._scene = self._o3d.t.geometry.RaycastingScene()
        self._scene.add_triangles(mesh.vertices.astype(np.float32), mesh.faces.astype(np.uint32))
        # Texture of each face, -1 for none, and the face's row there.
        self._texture, self._row = np.full((2, len(mesh.faces)), -1)
        for number, texture in enumerate(mesh.textures):
            self._texture[texture.faces], self._row[texture.faces] = (
                number,
                np.arange(len(texture.faces)),
            )

    def cast(self, camera: Camera, columns: Array, rows: Array) -> dict[str, Any]:
        """First hits of the rays through pixel coordinates ``columns`` [C] x ``rows`` [R].

        Returns ``hit`` [R, C] bool, ``depth`` [R, C] along the camera's z (infinite without a hit), ``face`` [R, C], ``normal``
        [R, C, 3] (world axes, length 1) and ``shares`` [R, C, 2], barycentric coordinates of the face's other two corners.
        """
        x = (columns - camera.K[0, 2]) / camera.K[0, 0]
        y = (rows - camera.K[1, 2]) / camera.K[1, 1]
        plane = np.empty((len(rows), len(columns), 3))
        plane[..., 0] = x[None, :] - camera.K[0, 1] / camera.K[0, 0] * y[:, None]
        plane[..., 1] = y[:, None]
        rays = np.empty((len(rows), len(columns), 6), dtype=np.float32)
        # A unit along a ray is a unit of depth; rays start at ``near``.
        near = 0.0
        if camera.model == "perspective":
            plane[..., 2] = 1.0
            rays[..., :3] = camera.position
            rays[..., 3:] = plane @ camera.R
        else:
            # In front of the whole mesh: an orthographic camera sees what lies behind its origin too.
            near = plane[..., 2] = (self.mesh.vertices @ camera.R[2]).min() + camera.t[2] - 1.0
            rays[..., :3] = (plane - camera.t) @ camera.R
            rays[..., 3:] = camera.R[2]
        hits = self._scene.cast_rays(self._o3d.core.Tensor(rays))
        depth = hits["t_hit"].numpy().astype(np.float64) + near
        names = {"face": "primitive_ids", "normal": "primitive_normals", "shares": "primitive_uvs"}
        return {
            "hit": np.isfinite(depth),
            "depth": depth,
            **{name: hits[key].numpy() for name, key in names.items()},
        }

    def colours(self, hits: dict[str, Any]) -> NDArray[np.uint8]:
        """The mesh's unlit colour [R, C, 3] at the ``hits`` of `cast`; arbitrary where nothing is hit."""
        face = np.where(hits["hit"], hits["face"], 0)
        colours = (
            np.full((*face.shape, 3), GREY, np.uint8)
            if self.mesh.colours is None
            else self.mesh.colours[face]
        )
        texture = np.where(hits["hit"], self._texture[face], -1)
        for number in np.unique(texture[texture >= 0]):
            textured = texture == number
            colours[textured] = self.mesh.textures[number].at(
                self._row[face[textured]], hits["shares"][textured]
            )
        return colours


def render_view(
    scene: RayScene, camera: Camera, rng: np.random.Generator | None = None
) -> RenderedView:
    """Picture and mask of ``scene`` seen by ``camera``.

    A pixel is inside the mask when more than half of its 25 rays hit the mesh; its colour is their mean, over white. Lambert
    shading of both sides of a face, by one distant light in a direction that ``rng`` draws; without it from the upper left.
    """
    height, width = camera.height, camera.width
    image = np.full((height, width, 3), 255, dtype=np.uint8)
    mask = np.zeros((height, width), dtype=np.uint8)
    light = camera.R.T @ _light(rng)
    box = _visible_box(scene.mesh.vertices, camera)
    if box is None:
        return RenderedView(image, mask, camera)
    left, top, right, bottom = box
    offsets = (np.arange(RAYS_ACROSS) + 0.5) / RAYS_ACROSS - 0.5
    columns = (np.arange(left, right)[:, None] + offsets).ravel()
    rows_at_once = max(1, RAYS_AT_ONCE // (len(columns) * RAYS_ACROSS))
    for start in range(top, bottom, rows_at_once):
        stop = min(start + rows_at_once, bottom)
        hits = scene.cast(camera, columns, (np.arange(start, stop)[:, None] + offsets).ravel())
        shape = (stop - start, RAYS_ACROSS, right - left, RAYS_ACROSS)
        hit = hits["hit"]
        shade = AMBIENT + (1.0 - AMBIENT) * np.abs(hits["normal"] @ light.astype(np.float32))
        if scene.mesh.colours is None and not scene.mesh.textures:
            colour = np.where(hit, shade * GREY[0], 255.0)[..., None]
        else:
            colour = np.where(hit[..., None], shade[..., None] * scene.colours(hits), 255.0)
        pixels = colour.reshape(*shape, -1).mean(axis=(1, 3))
        image[start:stop, left:right] = np.clip(np.rint(pixels), 0, 255).astype(np.uint8)
        covered = hit.reshape(shape).sum(axis=(1, 3)) * 2 > RAYS_ACROSS**2
        mask[start:stop, left:right] = np.where(covered, 255, 0)
    return RenderedView(image, mask, camera)


def _light(rng: np.random.Generator | None) -> Array:
    """Unit vector toward the light in camera axes, on the camera's side and mostly from above."""
    direction = (
        np.array([-0.5, -0.7, -0.6])
        if rng is None
        else rng.normal([0.0, -0.6, -0.8], [0.6, 0.4, 0.3])
    )
    return direction / max(float(np.linalg.norm(direction)), 1e-9)


def _visible_box(vertices: Array, camera: Camera) -> tuple[int, int, int, int] | None:
    """Pixel columns and rows (left, top, right, bottom; half open) that the mesh can cover; None if it is out of sight."""
    pixels, depth = camera.project(vertices)
    if camera.model == "perspective" and depth.min() <= 0.0:
        return 0, 0, camera.width, camera.height
    low = np.floor(pixels.min(axis=0) - 0.5)
    high = np.ceil(pixels.max(axis=0) + 0.5) + 1.0
    limit = np.array([camera.width, camera.height])
    left, top = np.clip(low, 0, limit).astype(int).tolist()
    right, bottom = np.clip(high, 0, limit).astype(int).tolist()
    return (left, top, right, bottom) if left < right and top < bottom else None
