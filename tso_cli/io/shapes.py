"""Any file that describes a shape -> points that measure it.

- A point cloud gives its points; a single point is enough.
- A mesh (.obj, .off, .stl, .glb, or .ply with faces) gives points drawn uniformly from its surface.
- A voxel grid (.npy of 3 dimensions, .binvox) gives points drawn from its boundary, which marching
  cubes finds at occupancy 0.5.

Clouds and meshes keep their units and place. The longest side of a .npy grid becomes 1 and its
centre the origin; the axes of the array are x, y, z. The occupied part of a .binvox grid is centred
at the origin, as the models of ShapeNet are. Its `translate` is not used: depending on the options
of the program that made the file, it is the corner of the object or of the grid.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError, prefixed
from ..geometry.arrays import Array, Bits, Indices
from ..geometry.points import sample_surface
from .clouds import SUFFIXES as CLOUD_SUFFIXES
from .clouds import colmap_points, read_cloud
from .meshes import SUFFIXES as mesh_suffixes
from .meshes import read_mesh
from .ply_header import HEADER_LIMIT
from .reading import read_array, read_bytes, require_memory, shown

MESH_SUFFIXES = tuple(suffix for suffix in mesh_suffixes if suffix != ".ply")
SUFFIXES = (*dict.fromkeys((*CLOUD_SUFFIXES, *MESH_SUFFIXES)), ".binvox")

FEWEST_POINTS = 64  # of each cloud of a batch; shorter sides are those of a grid
MAX_VOXELS = 512**3  # marching cubes of such a grid already takes gigabytes
_FACES = re.compile(rb"[\r\n]element[ \t]+face[ \t]+0*[1-9]")
_NPY_GRID = re.compile(
    rb"\A\x93NUMPY[^\n]{0,200}'shape': *\(([0-9]{1,9}), *([0-9]{1,9}), *([0-9]{1,9}),?\)", re.DOTALL
)


def shape_kind(path: Path) -> str:
    """What the file ``path`` is read as: "cloud", "mesh" or "voxels"; unreadable files: "cloud"."""
    suffix = path.suffix.lower()
    if colmap_points(path) is not None:
        return "cloud"
    if suffix not in SUFFIXES and not path.is_dir():
        from .plugins import readers

        plugins = readers()
        if suffix in plugins:
            return "cloud"
        raise InputError(
            f"{path}: the suffix is {suffix!r}, "
            f"expected a cloud, mesh or grid: {', '.join((*SUFFIXES, *plugins))}"
        )
    if suffix in MESH_SUFFIXES:
        return "mesh"
    try:
        head = read_bytes(path, "a shape", most=HEADER_LIMIT) if suffix in (".ply", ".npy") else b""
    except InputError:
        return "cloud"  # the reader of clouds says why the file cannot be read
    if suffix == ".ply" and _FACES.search(head.partition(b"end_header")[0]):
        return "mesh"
    if suffix == ".binvox":
        return "voxels"
    grid = _NPY_GRID.search(head)
    if grid is None:
        return "cloud"
    # A batch of clouds [B, N, 3] has a last side of 3, and many points.
    first, points, last = (int(side) for side in grid.groups())
    batch = last == 3 and (first == 1 or points >= FEWEST_POINTS)
    return "cloud" if batch else "voxels"


def read_shape(
    path: Path, samples: int = 16384, seed: int | Sequence[int] = 0, as_vertices: bool = False
) -> Array:
    """The points [N, 3] that measure the shape in a file.

    A cloud gives its own points; of a surface ``samples`` points are drawn. With ``as_vertices``
    a mesh gives its vertices. Raises InputError if the file has neither points nor a surface.
    """
    surface = None if as_vertices and path.suffix.lower() == ".ply" else read_surface(path)
    if surface is None:
        return read_cloud(path, extended=False).points
    vertices, faces = surface
    if as_vertices and shape_kind(path) == "mesh":
        return vertices
    with prefixed(f"{path}: "):
        return sample_surface(vertices, faces, samples, np.random.default_rng(seed))


def read_surface(path: Path) -> tuple[Array, Indices] | None:
    """Vertices [V, 3] and faces [F, 3] of the mesh or grid in a file; None for a cloud.

    Raises InputError as `read_mesh`, or if the grid has no occupied voxel.
    """
    kind = shape_kind(path)
    if kind == "mesh":
        mesh = read_mesh(path, textures=False)
        return mesh.vertices, mesh.faces
    return grid_surface(path) if kind == "voxels" else None


def grid_surface(path: Path) -> tuple[Array, Indices]:
    """Vertices [V, 3] and faces [F, 3] of the closed boundary of a voxel grid (.npy, .binvox)."""
    binvox = path.suffix.lower() == ".binvox"
    grid, side = _read_binvox(path) if binvox else (_read_npy_grid(path), 1.0)
    occupied = grid > 0.5
    if not occupied.any():
        sides = " x ".join(map(str, grid.shape))
        raise InputError(
            f"{path}: no voxel of the {sides} grid is occupied (> 0.5), expected a shape"
        )
    from skimage.measure import marching_cubes

    # Large grids are mostly empty, so the shape is cut out. A padding of one voxel on every side
    # makes its surface closed.
    spans = [np.flatnonzero(occupied.any(axis)) for axis in ((1, 2), (0, 2), (0, 1))]
    corner = np.array([max(int(span[0]) - 1, 0) for span in spans])
    part = grid[tuple(slice(c, int(span[-1]) + 2) for c, span in zip(corner, spans, strict=True))]
    padded = np.pad(np.clip(part, 0.0, 1.0).astype(np.float32), 1)
    vertices, faces, _, _ = marching_cubes(padded, 0.5)
    # Voxel i spans i to i + 1 in units of a voxel; its value is the value at the middle.
    centres = np.asarray(vertices, dtype=np.float64) - 1.0 + corner + 0.5
    middle = np.array(grid.shape) / 2.0
    if binvox:
        middle = (centres.min(axis=0) + centres.max(axis=0)) / 2.0
    return side / max(grid.shape) * (centres - middle), np.asarray(faces, dtype=np.int64)


def _read_binvox(path: Path) -> tuple[Bits, float]:
    """Occupancy [X, Y, Z] and the longest side of the whole grid, in model units."""
    # Two bytes hold at least one voxel: a longer file is wrong.
    content = read_bytes(path, "a .binvox grid", limit=2 * MAX_VOXELS + 4096)
    header = re.compile(rb"#binvox 1\s(.*?)\ndata\r?\n", re.DOTALL).match(content, 0, 4096)
    if header is None:
        raise InputError(
            f"{path}: starts with {shown(content[:12])}, "
            "expected a .binvox header (#binvox 1 ... data)"
        )
    fields = {line.split()[0]: line.split()[1:] for line in header[1].splitlines() if line.strip()}
    depth, height, width = (int(side) for side in _numbers(path, fields, b"dim", 3))
    scale = _numbers(path, fields, b"scale", 1)[0] if b"scale" in fields else 1.0
    total = depth * height * width
    if min(depth, height, width) < 1 or total > MAX_VOXELS:
        raise InputError(
            f"{path}: dim is {shown(f'{depth} {height} {width}')}, "
            f"expected 1 to {MAX_VOXELS:,} voxels"
        )
    require_memory(path, 16 * total)  # the most bytes of a voxel on the way to a surface
    if not 1e-30 < scale < 1e30:
        raise InputError(f"{path}: scale is {scale:g}, expected a size > 0")
    runs = np.frombuffer(content[header.end() :], dtype=np.uint8)
    if len(runs) % 2:
        raise InputError(f"{path}: ends in the middle of a run, expected a whole file")
    values, counts = runs[0::2], runs[1::2].astype(np.int64)
    if (values > 1).any():
        raise InputError(f"{path}: a run has the value {int(values.max())}, expected 0 or 1")
    if int(counts.sum()) != total:
        raise InputError(
            f"{path}: its runs hold {int(counts.sum()):,} voxels, expected {total:,} as dim says"
        )
    # In the file y changes fastest, then z, then x.
    grid = np.repeat(values.astype(bool), counts).reshape(depth, height, width).transpose(0, 2, 1)
    return grid, scale


def _read_npy_grid(path: Path) -> NDArray[Any]:
    grid = read_array(read_bytes(path, "a voxel grid", limit=8 * MAX_VOXELS + 65536), path)
    if grid.ndim != 3 or grid.dtype.kind not in "biuf":
        raise InputError(
            f"{path}: holds {grid.dtype} {list(grid.shape)}, expected a grid of numbers [X, Y, Z]"
        )
    if not 1 <= grid.size <= MAX_VOXELS:
        sides = " x ".join(map(str, grid.shape))
        raise InputError(f"{path}: the grid is {sides}, expected 1 to {MAX_VOXELS:,} voxels")
    if not np.isfinite(grid).all():
        raise InputError(f"{path}: a voxel is NaN or infinite, expected occupancy from 0 to 1")
    return grid


def _numbers(path: Path, fields: dict[bytes, list[bytes]], key: bytes, count: int) -> list[float]:
    try:
        values = [float(word) for word in fields[key]]
        fits = len(values) == count and all(map(math.isfinite, values))
        if not fits or (key == b"dim" and any(value % 1 for value in values)):
            raise ValueError
    except (KeyError, ValueError):
        what = shown(b" ".join(fields[key]).decode("latin-1")) if key in fields else "missing"
        numbers = "finite numbers" if count > 1 else "finite number"
        raise InputError(f"{path}: {key.decode()} is {what}, expected {count} {numbers}") from None
    return values
