"""Meshes -> images, masks, cameras and ground truth, by casting rays.

Every mesh is first centred on its bounding box and scaled to longest side 1. y is up; azimuth 0 looks along -z at the side
that faces +z, and grows toward +x; the camera looks at the origin. At azimuth and elevation 0 its R is the canonical one.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import __version__
from .camera import CANONICAL_DISTANCE, CANONICAL_FOCAL_AT_64, Camera
from .datasets.rendered import stored_record, write_object
from .errors import InputError, TsoError
from .files.meshes import GREY, Mesh, find_meshes, read_mesh
from .geometry import farthest_point_sample

Array = NDArray[np.float64]

RAYS_ACROSS = 5
"""Rays across one pixel, 25 in all. An odd number: with an even one, ties at half cover would move every outline."""
MARGIN_PX = 2.0
"""Free border left around the object when the distance is chosen here."""
AMBIENT = 0.3


@dataclass(frozen=True)
class RenderSettings:
    """What to render of every mesh.

    Parameters
    ----------
    views : pictures of each object.
    size : width, height in pixels.
    azimuth, elevation : range in degrees from which each view draws uniformly.
    distance : of the camera from the centre, in longest sides; None takes for each view the smallest, 2 or more, at which the
        whole object is in the picture.
    focal : focal length in pixels; None is 120 for each 64 of the longer side.
    samples : points drawn from the surface; points : how many of them farthest-point sampling keeps.

    Raises
    ------
    InputError
        A number is outside what makes sense.
    """

    views: int = 24
    size: tuple[int, int] = (64, 64)
    azimuth: tuple[float, float] = (0.0, 360.0)
    elevation: tuple[float, float] = (-5.0, 40.0)
    distance: float | None = None
    focal: float | None = None
    samples: int = 16384
    points: int = 1024

    def __post_init__(self) -> None:
        if self.views < 1:
            raise InputError(f"views is {self.views}, expected 1 or more")
        if min(self.size) < 8 or max(self.size) > 8192:
            raise InputError(f"size is {self.size[0]}x{self.size[1]}, expected 8 to 8192 pixels each way")
        for name, limit in (("azimuth", 360.0), ("elevation", 90.0)):
            low, high = getattr(self, name)
            if not -limit <= low <= high <= limit:
                raise InputError(f"{name} is {low:g} to {high:g}, expected a range within -{limit:g} to {limit:g} degrees")
        for name in ("distance", "focal"):
            value = getattr(self, name)
            if value is not None and not (np.isfinite(value) and value > 0.0):
                raise InputError(f"{name} is {value:g}, expected more than 0")
        if not 1 <= self.points <= self.samples:
            raise InputError(f"points is {self.points} and samples {self.samples}, expected 1 <= points <= samples")


@dataclass(frozen=True, eq=False)
class RenderedView:
    """image [H, W, 3] uint8 on white, mask [H, W] uint8 (255 inside, 0 outside), and the camera of both."""

    image: NDArray[np.uint8]
    mask: NDArray[np.uint8]
    camera: Camera


@dataclass(frozen=True, eq=False)
class RenderedObject:
    """Pictures and ground truth of one mesh, longest side 1.

    samples : [S, 3] float32 points of the surface; target : [P, 3] float32, the farthest-point subset of them.
    """

    name: str
    views: list[RenderedView]
    samples: NDArray[np.float32]
    target: NDArray[np.float32]


@dataclass(frozen=True)
class RenderSummary:
    """What render_folder did.

    written, skipped : names of the objects rendered now and of those that were there already; failed : name -> why not.
    """

    folder: Path
    written: list[str] = field(default_factory=list)
    skipped: list[str] = field(default_factory=list)
    failed: dict[str, str] = field(default_factory=dict)


def normalise(mesh: Mesh) -> Mesh:
    """The mesh centred on the bounding box of its faces and scaled to longest side 1, without vertices no face uses."""
    used, faces = np.unique(mesh.faces, return_inverse=True)
    vertices = mesh.vertices[used]
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    vertices = (vertices - (low + high) / 2.0) / (high - low).max()
    return Mesh(vertices, faces.reshape(mesh.faces.shape).astype(np.int64), mesh.colours)


def look_at(
    azimuth: float, elevation: float, distance: float, size: tuple[int, int], focal: float | None = None
) -> Camera:
    """The camera at ``azimuth`` and ``elevation`` (degrees), ``distance`` from the origin and looking at it.

    ``size`` is width, height; ``focal`` is in pixels, None is 120 for each 64 of the longer side.
    """
    width, height = size
    focal = CANONICAL_FOCAL_AT_64 * max(size) / 64.0 if focal is None else focal
    sin_a, cos_a = np.sin(np.radians(azimuth)), np.cos(np.radians(azimuth))
    sin_e, cos_e = np.sin(np.radians(elevation)), np.cos(np.radians(elevation))
    right = [cos_a, 0.0, -sin_a]
    down = [sin_e * sin_a, -cos_e, sin_e * cos_a]
    forward = [-cos_e * sin_a, -sin_e, -cos_e * cos_a]
    K = np.array([[focal, 0.0, (width - 1) / 2.0], [0.0, focal, (height - 1) / 2.0], [0.0, 0.0, 1.0]])
    return Camera(K, np.array([right, down, forward]), np.array([0.0, 0.0, distance]), width, height)


def fitting_distance(vertices: Array, camera: Camera, margin: float = MARGIN_PX) -> float:
    """Smallest distance, 2 or more, at which ``vertices`` [V, 3] lie inside the picture of ``camera`` less ``margin`` px.

    Exact: with x, z the coordinates of a vertex in the camera's axes, |fx x| / (z + d) <= W/2 - margin holds from
    d = |fx x| / (W/2 - margin) - z on; the same for y, and the largest over the vertices is taken.
    """
    half = np.array([camera.width, camera.height]) / 2.0
    half -= np.minimum(margin, half / 4.0)
    turned = vertices @ camera.R.T
    needed = np.abs(turned[:, :2]) * camera.K[[0, 1], [0, 1]] / half - turned[:, 2:]
    # The last term keeps every vertex in front of the camera, also those on its axis.
    return float(max(CANONICAL_DISTANCE, needed.max(), 0.01 - turned[:, 2].min()))


def sample_cameras(settings: RenderSettings, vertices: Array, rng: np.random.Generator) -> list[Camera]:
    """Cameras on random directions around the normalised ``vertices`` [V, 3], as ``settings`` says.

    Raises InputError if a fixed distance puts the camera inside the object.
    """
    cameras = []
    for _ in range(settings.views):
        azimuth = rng.uniform(*settings.azimuth)
        elevation = rng.uniform(*settings.elevation)
        camera = look_at(azimuth, elevation, settings.distance or CANONICAL_DISTANCE, settings.size, settings.focal)
        if settings.distance is None:
            distance = fitting_distance(vertices, camera)
            camera = look_at(azimuth, elevation, distance, settings.size, settings.focal)
        elif camera.t[2] + (vertices @ camera.R[2]).min() <= 0.0:
            raise InputError(
                f"distance is {settings.distance:g}: the camera would stand inside the object, "
                "which reaches up to 0.87 from its centre; expected 1 or more"
            )
        cameras.append(camera)
    return cameras


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

    def cast(self, camera: Camera, columns: Array, rows: Array) -> dict[str, Any]:
        """What the rays through pixel coordinates ``columns`` [C] x ``rows`` [R] meet first.

        Returns ``hit`` [R, C] bool, ``face`` [R, C] and ``normal`` [R, C, 3] (world axes, length 1).
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
            rays[..., :3] = -camera.R.T @ camera.t
            rays[..., 3:] = plane @ camera.R
        else:
            # Parallel rays start in front of everything: an orthographic camera sees what lies behind its origin too.
            plane[..., 2] = (self.mesh.vertices @ camera.R[2]).min() + camera.t[2] - 1.0
            rays[..., :3] = (plane - camera.t) @ camera.R
            rays[..., 3:] = camera.R[2]
        found = self._scene.cast_rays(self._o3d.core.Tensor(rays))
        return {
            "hit": np.isfinite(found["t_hit"].numpy()),
            "face": found["primitive_ids"].numpy(),
            "normal": found["primitive_normals"].numpy(),
        }


def render_view(scene: RayScene, camera: Camera, rng: np.random.Generator | None = None) -> RenderedView:
    """Picture and mask of ``scene`` seen by ``camera``.

    A pixel is inside the mask when more than half of its 25 rays meet the mesh. The picture is their mean over white, shaded
    by one far light (Lambert, both sides of a face alike) whose direction ``rng`` draws; without it, it stands up on the left.
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
    rows_at_once = max(1, 2**21 // (len(columns) * RAYS_ACROSS))
    for start in range(top, bottom, rows_at_once):
        stop = min(start + rows_at_once, bottom)
        found = scene.cast(camera, columns, (np.arange(start, stop)[:, None] + offsets).ravel())
        shape = (stop - start, RAYS_ACROSS, right - left, RAYS_ACROSS)
        hit = found["hit"]
        shade = AMBIENT + (1.0 - AMBIENT) * np.abs(found["normal"] @ light.astype(np.float32))
        if scene.mesh.colours is None:
            colour = np.where(hit, shade * GREY[0], 255.0)[..., None]
        else:
            own = scene.mesh.colours[np.where(hit, found["face"], 0)]
            colour = np.where(hit[..., None], shade[..., None] * own, 255.0)
        pixels = colour.reshape(*shape, -1).mean(axis=(1, 3))
        image[start:stop, left:right] = np.clip(np.rint(pixels), 0, 255).astype(np.uint8)
        covered = hit.reshape(shape).sum(axis=(1, 3)) * 2 > RAYS_ACROSS**2
        mask[start:stop, left:right] = np.where(covered, 255, 0)
    return RenderedView(image, mask, camera)


def sample_surface(mesh: Mesh, count: int, rng: np.random.Generator) -> Array:
    """``count`` points [count, 3], uniform over the area of the faces."""
    corners = mesh.vertices[mesh.faces]
    side, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = np.linalg.norm(np.cross(side, other), axis=1)
    face = rng.choice(len(area), size=count, p=area / area.sum())
    weights = rng.random((2, count, 1))
    # The half of the parallelogram beyond the triangle is folded back onto it.
    weights = np.where(weights.sum(axis=0) > 1.0, 1.0 - weights, weights)
    return corners[face, 0] + weights[0] * side[face] + weights[1] * other[face]


def ground_truth(mesh: Mesh, settings: RenderSettings, rng: np.random.Generator) -> tuple[Array, Array]:
    """Surface samples [samples, 3] and the farthest-point subset of them [points, 3]."""
    samples = sample_surface(mesh, settings.samples, rng)
    return samples, samples[farthest_point_sample(samples, settings.points)]


def render_mesh(
    mesh: Mesh, settings: RenderSettings, rng: np.random.Generator, name: str = "object"
) -> RenderedObject:
    """Normalise ``mesh``, draw its views and its ground truth."""
    mesh = normalise(mesh)
    scene = RayScene(mesh)
    views = [render_view(scene, camera, rng) for camera in sample_cameras(settings, mesh.vertices, rng)]
    samples, target = ground_truth(mesh, settings, rng)
    return RenderedObject(name, views, samples.astype(np.float32), target.astype(np.float32))


def render_folder(
    source: Path | str,
    output: Path | str,
    settings: RenderSettings,
    seed: int = 0,
    overwrite: bool = False,
    progress: Callable[[int, int, str], None] | None = None,
) -> RenderSummary:
    """Render a mesh, or every mesh of a folder, into ``output``/NAME as `datasets.rendered` describes.

    NAME is the file's path below ``source`` without suffix. An object is written whole or not at all and depends only on its
    mesh, its name, ``settings`` and ``seed``, so that a run that was stopped can be started again and goes on: what is there
    and was made alike is skipped. A mesh of a folder that cannot be rendered is left out and named in ``failed``.

    Parameters
    ----------
    progress : called with objects done, objects in all and the name of the last one.

    Raises
    ------
    InputError
        There is no mesh; ``output`` cannot be a folder; two meshes have one name; an object is there that other settings
        made and ``overwrite`` is false; no mesh could be rendered.
    TsoError
        open3d is missing, or writing failed.
    """
    source, output = Path(source), Path(output)
    if seed < 0:
        raise InputError(f"seed is {seed}, expected 0 or more")
    _check_folder(output)
    meshes = _names(source, output)
    record = {"tso": __version__, "seed": seed, **asdict(settings)}
    summary = RenderSummary(output)
    waiting = []
    # All of what is there is looked at before the work starts: a clash of settings should not show after an hour.
    for name, path in meshes.items():
        found = stored_record(output / name)
        if found is None or overwrite:
            waiting.append((name, path))
            continue
        for key, value in record.items():
            value = list(value) if isinstance(value, tuple) else value
            if key != "tso" and found.get(key) != value:
                raise InputError(
                    f"{output / name}: was rendered with {key} {found.get(key)}, now it is {value}; "
                    "expected the same settings, --overwrite or another output folder"
                )
        summary.skipped.append(name)
    for done, (name, path) in enumerate(waiting):
        try:
            rng = np.random.default_rng([seed, zlib.crc32(name.encode())])
            rendered = render_mesh(read_mesh(path), settings, rng, name)
        except InputError as error:
            if len(meshes) == 1:
                raise
            summary.failed[name] = str(error) if str(path) in str(error) else f"{path}: {error}"
        else:
            views = [(view.image, view.mask, view.camera) for view in rendered.views]
            write_object(output / name, views, rendered.samples, rendered.target, {"mesh": path.name, **record}, overwrite)
            summary.written.append(name)
        if progress is not None:
            progress(done + 1, len(waiting), name)
    if summary.failed and not (summary.written or summary.skipped):
        raise InputError(f"none of {len(meshes)} meshes could be rendered, the first: {next(iter(summary.failed.values()))}")
    return summary


def _check_folder(output: Path) -> None:
    if output.exists() and not output.is_dir():
        raise InputError(f"{output}: is a file, expected the name of a folder to write to")
    parent = output.resolve().parent
    if not parent.is_dir():
        raise InputError(f"{output}: the folder {parent} does not exist, expected one to write to")


def _names(source: Path, output: Path) -> dict[str, Path]:
    """Name of each object -> its mesh."""
    if not source.is_dir():
        return {source.stem: source}
    inside = output.resolve()
    meshes: dict[str, Path] = {}
    for path in find_meshes(source):
        if inside != source.resolve() and inside in path.resolve().parents:
            continue  # written by an earlier run
        name = path.relative_to(source).with_suffix("").as_posix()
        if name in meshes:
            raise InputError(f"{path}: would be rendered as {name}, as would {meshes[name]}; expected different names")
        meshes[name] = path
    for name, path in meshes.items():
        above = next((parent.as_posix() for parent in Path(name).parents if parent.as_posix() in meshes), None)
        if above is not None:
            raise InputError(f"{path}: would be rendered inside {above}, made of {meshes[above]}; expected another name")
    if not meshes:
        raise InputError(f"{source}: no mesh in this folder beside those of {output}")
    return meshes


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
