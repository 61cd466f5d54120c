"""One mesh, one camera: a picture and a mask."""

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
"""Rays across one pixel, 25 in all. An odd number: with an even one, ties at half cover would move every outline."""
RAYS_AT_ONCE = 1 << 21
AMBIENT = 0.3
"""Brightness of a face that the light only grazes."""


@dataclass(frozen=True, eq=False)
class RenderedView:
    """image [H, W, 3] uint8 on white, mask [H, W] uint8 (255 inside, 0 outside), and the camera of both."""

    image: NDArray[np.uint8]
    mask: NDArray[np.uint8]
    camera: Camera


class RayScene:
    """A mesh ready for ray casting.

    Parameters
    ----------
    mesh : used in its own coordinates; single precision, so normalise first what lies far from the origin.

    Raises
    ------
    TsoError
        open3d, which casts the rays, is missing or cannot be loaded.
    """

    def __init__(self, mesh: Mesh) -> None:
        self._o3d = _open3d()
        self.mesh = mesh
        self._scene = self._o3d.t.geometry.RaycastingScene()
        self._scene.add_triangles(mesh.vertices.astype(np.float32), mesh.faces.astype(np.uint32))
        # Which texture each face wears, -1 for none, and its row there.
        self._texture, self._row = np.full((2, len(mesh.faces)), -1)
        for number, texture in enumerate(mesh.textures):
            self._texture[texture.faces], self._row[texture.faces] = number, np.arange(len(texture.faces))

    def cast(self, camera: Camera, columns: Array, rows: Array) -> dict[str, Any]:
        """What the rays through pixel coordinates ``columns`` [C] x ``rows`` [R] meet first.

        Returns ``hit`` [R, C] bool, ``face`` [R, C], ``normal`` [R, C, 3] (world axes, length 1), ``shares`` [R, C, 2] (how far
        from the face's first corner toward the second and the third) and ``depth`` [R, C] along the camera's z, infinite where
        nothing is met.
        """
        x = (columns - camera.K[0, 2]) / camera.K[0, 0]
        y = (rows - camera.K[1, 2]) / camera.K[1, 1]
        # The skew of K moves u with y.
        plane = np.empty((len(rows), len(columns), 3))
        plane[..., 0] = x[None, :] - camera.K[0, 1] / camera.K[0, 0] * y[:, None]
        plane[..., 1] = y[:, None]
        plane[..., 2] = 1.0
        rays = np.empty((len(rows), len(columns), 6), dtype=np.float32)
        if camera.model == "perspective":
            rays[..., :3] = camera.position
            rays[..., 3:] = plane @ camera.R
        else:
            # Parallel rays start in front of everything: an orthographic camera sees what lies behind its origin too.
            plane[..., 2] = (self.mesh.vertices @ camera.R[2]).min() + camera.t[2] - 1.0
            rays[..., :3] = (plane - camera.t) @ camera.R
            rays[..., 3:] = camera.R[2]
        found = self._scene.cast_rays(self._o3d.core.Tensor(rays))
        # One unit along a ray is one in depth; parallel rays start at a depth of their own.
        depth = found["t_hit"].numpy().astype(np.float64) + (plane[..., 2] if camera.model != "perspective" else 0.0)
        return {
            "hit": np.isfinite(depth),
            "depth": depth,
            "face": found["primitive_ids"].numpy(),
            "normal": found["primitive_normals"].numpy(),
            "shares": found["primitive_uvs"].numpy(),
        }

    def colours(self, found: dict[str, Any]) -> NDArray[np.uint8]:
        """The mesh's own colour [R, C, 3] where the rays of `cast` met it, without light; elsewhere it means nothing."""
        face = np.where(found["hit"], found["face"], 0)
        own = np.full((*face.shape, 3), GREY, np.uint8) if self.mesh.colours is None else self.mesh.colours[face]
        worn = np.where(found["hit"], self._texture[face], -1)
        for number in np.unique(worn[worn >= 0]):
            here = worn == number
            own[here] = self.mesh.textures[number].at(self._row[face[here]], found["shares"][here])
        return own


def render_view(scene: RayScene, camera: Camera, rng: np.random.Generator | None = None) -> RenderedView:
    """Picture and mask of ``scene`` seen by ``camera``.

    A pixel is inside the mask when more than half of its 25 rays meet the mesh. The picture is their mean over white. Each has
    the colour of the texture where it meets the mesh, else of the face, shaded by one far light (Lambert, both sides of a face
    alike) whose direction ``rng`` draws; without it, it stands up on the left.
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
        found = scene.cast(camera, columns, (np.arange(start, stop)[:, None] + offsets).ravel())
        shape = (stop - start, RAYS_ACROSS, right - left, RAYS_ACROSS)
        hit = found["hit"]
        shade = AMBIENT + (1.0 - AMBIENT) * np.abs(found["normal"] @ light.astype(np.float32))
        if scene.mesh.colours is None and not scene.mesh.textures:
            colour = np.where(hit, shade * GREY[0], 255.0)[..., None]
        else:
            colour = np.where(hit[..., None], shade[..., None] * scene.colours(found), 255.0)
        pixels = colour.reshape(*shape, -1).mean(axis=(1, 3))
        image[start:stop, left:right] = np.clip(np.rint(pixels), 0, 255).astype(np.uint8)
        covered = hit.reshape(shape).sum(axis=(1, 3)) * 2 > RAYS_ACROSS**2
        mask[start:stop, left:right] = np.where(covered, 255, 0)
    return RenderedView(image, mask, camera)


def _open3d() -> Any:
    try:
        import open3d
    except (ImportError, OSError) as error:
        reason = " ".join(str(error).split())
        raise TsoError(
            f"rendering needs open3d ({reason}): pip install 'tso-cli[render]', "
            "and on Debian apt-get install libusb-1.0-0 libgl1 libegl1 libx11-6 libgomp1"
        ) from None
    return open3d


def _light(rng: np.random.Generator | None) -> Array:
    """Unit vector toward the light in camera axes: on the camera's side and mostly from above."""
    direction = np.array([-0.5, -0.7, -0.6]) if rng is None else rng.normal([0.0, -0.6, -0.8], [0.6, 0.4, 0.3])
    return direction / max(float(np.linalg.norm(direction)), 1e-9)


def _visible_box(vertices: Array, camera: Camera) -> tuple[int, int, int, int] | None:
    """Pixel columns and rows (left, top, right, bottom; half open) that the mesh can touch, None if it is out of sight."""
    pixels, depth = camera.project(vertices)
    if camera.model == "perspective" and depth.min() <= 0.0:
        return 0, 0, camera.width, camera.height
    low = np.floor(pixels.min(axis=0) - 0.5)
    high = np.ceil(pixels.max(axis=0) + 0.5) + 1.0
    limit = np.array([camera.width, camera.height])
    left, top = np.clip(low, 0, limit).astype(int).tolist()
    right, bottom = np.clip(high, 0, limit).astype(int).tolist()
    return (left, top, right, bottom) if left < right and top < bottom else None
