"""Ray casting: picture and mask of one mesh seen by one camera."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import TsoError
from ..geometry.arrays import Array, Pixels
from ..geometry.camera import Camera
from ..io.meshes import Mesh
from ..signals import waiting_signals

# Rays across one pixel, 25 in all. An odd number has no ties at half coverage, which would shift
# outlines.
RAYS_ACROSS = 5
RAYS_AT_ONCE = 1 << 21  # bounds the memory to some hundred megabytes
GREY = (170, 170, 170)  # the colour of a mesh without paint
# Brightness of a face that is parallel to the light; a face toward the light has brightness 1.
AMBIENT = 0.3


@dataclass(frozen=True, eq=False)
class RenderedView:
    """A picture of a mesh on white, its mask and the camera of both."""

    image: Pixels  # [H, W, 3]
    mask: Pixels  # [H, W], 255 inside, 0 outside
    camera: Camera


class RayScene:
    """A mesh that is ready for ray casting, in single precision.

    A mesh far from the origin must be normalised first, or it loses detail. Raises TsoError if
    open3d, which casts the rays, is missing or cannot be loaded.
    """

    def __init__(self, mesh: Mesh) -> None:
        try:
            with waiting_signals():
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

    def cast(self, camera: Camera, columns: Array, rows: Array) -> dict[str, Any]:
        """First hits of the rays through pixel coordinates ``columns`` [C] x ``rows`` [R].

        Returns
        -------
        hit : [R, C] bool.
        depth : [R, C] along the camera's z; infinite without a hit.
        face : [R, C].
        normal : [R, C, 3] in world axes, of length 1.
        barycentric : [R, C, 2], coordinates of the second and the third corner of the face.
        """
        x = (columns - camera.K[0, 2]) / camera.K[0, 0]
        y = (rows - camera.K[1, 2]) / camera.K[1, 1]
        plane = np.empty((len(rows), len(columns), 3))
        plane[..., 0] = x[None, :] - camera.K[0, 1] / camera.K[0, 0] * y[:, None]
        plane[..., 1] = y[:, None]
        rays = np.empty((len(rows), len(columns), 6), dtype=np.float32)
        # A unit along a ray is a unit of depth. Rays start at the depth ``near``.
        near = 0.0
        if camera.model == "perspective":
            plane[..., 2] = 1.0
            rays[..., :3] = camera.position
            rays[..., 3:] = plane @ camera.R
        else:
            # An orthographic camera also sees what lies behind its origin: rays start in front of
            # the whole mesh.
            near = plane[..., 2] = (self.mesh.vertices @ camera.R[2]).min() + camera.t[2] - 1.0
            rays[..., :3] = (plane - camera.t) @ camera.R
            rays[..., 3:] = camera.R[2]
        hits = self._scene.cast_rays(self._o3d.core.Tensor(rays))
        depth = hits["t_hit"].numpy().astype(np.float64) + near
        return {
            "hit": np.isfinite(depth),
            "depth": depth,
            "face": hits["primitive_ids"].numpy(),
            "normal": hits["primitive_normals"].numpy(),
            "barycentric": hits["primitive_uvs"].numpy(),
        }

    def first(self, start: Array, along: Array) -> Array:
        """[N]: how often ``along`` [N, 3] fits between ``start`` [N, 3] and the first hit."""
        rays = np.concatenate([start, along], 1).astype(np.float32)
        distance = self._scene.cast_rays(self._o3d.core.Tensor(rays))["t_hit"].numpy()
        distances: Array = distance.astype(np.float64)
        return distances

    def colours(self, hits: dict[str, Any]) -> Pixels:
        """The mesh's colour [R, C, 3] without light at the ``hits`` of `cast`.

        It is arbitrary where nothing is hit.
        """
        face = np.where(hits["hit"], hits["face"], 0)
        if self.mesh.paint is None:
            return np.full((*face.shape, 3), GREY, np.uint8)
        second_and_third = hits["barycentric"].reshape(-1, 2).astype(np.float64)
        shares = np.column_stack([1.0 - second_and_third.sum(1), second_and_third])
        colours = self.mesh.paint.at(face.ravel().astype(np.int64), shares)
        return np.rint(255.0 * colours).astype(np.uint8).reshape(*face.shape, 3)


def render_view(
    scene: RayScene, camera: Camera, rng: np.random.Generator | None = None
) -> RenderedView:
    """Picture and mask of ``scene`` seen by ``camera``.

    A pixel is inside the mask if more than half of its 25 rays hit the mesh. Its colour is the mean
    colour of its rays; rays that miss the mesh are white. Both sides of a face have Lambert
    shading, by one distant light. ``rng`` draws the direction of the light; without ``rng`` it
    comes from the upper left.
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
        if scene.mesh.paint is None:
            colour = np.where(hit, shade * GREY[0], 255.0)[..., None]
        else:
            colour = np.where(hit[..., None], shade[..., None] * scene.colours(hits), 255.0)
        pixels = colour.reshape(*shape, -1).mean(axis=(1, 3))
        image[start:stop, left:right] = np.clip(np.rint(pixels), 0, 255).astype(np.uint8)
        covered = hit.reshape(shape).sum(axis=(1, 3)) * 2 > RAYS_ACROSS**2
        mask[start:stop, left:right] = np.where(covered, 255, 0)
    return RenderedView(image, mask, camera)


def _light(rng: np.random.Generator | None) -> Array:
    """Unit vector toward the light, in camera axes: at the upper left, behind the camera.

    A random light is mostly above, on the camera's side.
    """
    direction = np.array((-0.5, -0.7, -0.6))
    if rng is not None:
        direction = rng.normal(loc=(0.0, -0.6, -0.8), scale=(0.6, 0.4, 0.3))
    return direction / max(float(np.linalg.norm(direction)), 1e-9)


def _visible_box(vertices: Array, camera: Camera) -> tuple[int, int, int, int] | None:
    """The pixels that the mesh can cover: left, top, right, bottom, right and bottom exclusive.

    None if the mesh is out of sight.
    """
    pixels, depth = camera.project(vertices)
    if camera.model == "perspective" and depth.min() <= 0.0:
        return 0, 0, camera.width, camera.height
    low = np.floor(pixels.min(axis=0) - 0.5)
    high = np.ceil(pixels.max(axis=0) + 0.5) + 1.0
    limit = np.array([camera.width, camera.height])
    left, top = np.clip(low, 0, limit).astype(int).tolist()
    right, bottom = np.clip(high, 0, limit).astype(int).tolist()
    return (left, top, right, bottom) if left < right and top < bottom else None
