"""The shapes of one part of a split, rendered, and the network that predicts them."""

from __future__ import annotations

import hashlib
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tso_cli.datasets.splits import read_part
from tso_cli.errors import InputError
from tso_cli.geometry.points import Array
from tso_cli.io.checkpoints import load_network
from tso_cli.io.meshes import Mesh, find_meshes, read_mesh
from tso_cli.io.shipped import PACKAGE
from tso_cli.network.model import BaseNetwork, NetworkConfig
from tso_cli.prior.learned import named_prior
from tso_cli.render.folder import ground_truth
from tso_cli.render.normalise import normalise
from tso_cli.render.rays import RayScene, RenderedView, render_view
from tso_cli.render.settings import RenderSettings
from tso_cli.render.viewpoints import sample_cameras

SPLIT = PACKAGE / "recipes" / "split.json"
"""Training, validation and test shapes of the shipped network."""


@dataclass(frozen=True)
class Shape:
    """A mesh file and its name in the split, CATEGORY/NAME."""

    name: str
    path: Path

    @property
    def category(self) -> str:
        return self.name.split("/")[0]

    def mesh(self) -> Mesh:
        """Longest side 1, centred."""
        return normalise(read_mesh(self.path))


@dataclass(frozen=True, eq=False)
class RenderedShape:
    """A shape, ``target`` [1024, 3] float64 on its surface, and rendered views."""

    scene: RayScene
    target: Array
    views: list[RenderedView]


def shapes_of_part(
    folder: Path,
    split_file: Path | None = None,
    part: str = "test",
    categories: Sequence[str] = (),
    limit: int | None = None,
) -> list[Shape]:
    """The shapes of one part of a split, sorted by category, in the order of the split.

    ``folder`` holds CATEGORY/NAME with a mesh's suffix for every name of the part. Without
    ``split_file`` the split is the shipped network's. At most ``limit`` shapes of each of
    ``categories`` (empty: all), spread evenly over the list.

    Raises InputError if the part or a category has no shape in the split, or a mesh is missing.
    """
    split_file = split_file or SPLIT
    names = read_part(split_file, part)
    if not names:
        raise InputError(f"{split_file}: names no shape for {part}, expected some")
    all_categories = sorted({name.split("/")[0] for name in names})
    for category in categories:
        if category not in all_categories:
            expected = f"expected some of {', '.join(all_categories)}"
            raise InputError(f"{split_file}: names no {category} for {part}, {expected}")
    meshes = {
        path.relative_to(folder).with_suffix("").as_posix(): path for path in find_meshes(folder)
    }
    chosen = []
    for category in [name for name in all_categories if not categories or name in categories]:
        members = [name for name in names if name.split("/")[0] == category]
        count = min(limit or len(members), len(members))
        chosen += [members[i] for i in np.linspace(0, len(members) - 1, count).round().astype(int)]
    missing = [name for name in chosen if name not in meshes]
    if missing:
        found = f"has no mesh {missing[0]} ({len(missing)} of {len(chosen)} are missing)"
        raise InputError(f"{folder}: {found}, expected those that {split_file} names for {part}")
    return [Shape(name, meshes[name]) for name in chosen]


def see(shape: Shape, settings: RenderSettings, seed: int) -> RenderedShape:
    """Render a shape; everything random depends on ``seed`` and the shape's name alone."""
    rng = np.random.default_rng([seed, zlib.crc32(shape.name.encode())])
    mesh = shape.mesh()
    target = ground_truth(mesh, settings, rng)[1].astype(np.float64)
    scene = RayScene(mesh)
    cameras = sample_cameras(settings, mesh.vertices, rng)
    return RenderedShape(scene, target, [render_view(scene, camera, rng) for camera in cameras])


def view_aligned_network(checkpoint: Path) -> tuple[BaseNetwork, NetworkConfig]:
    """The network of a checkpoint; InputError if it does not predict in the axes of the view."""
    network, about = load_network(checkpoint)
    if about.frame != "view":
        found = f"predicts in the {about.frame} frame"
        raise InputError(f"{checkpoint}: {found}, expected a view-aligned network")
    return network, about


def weights_hash(network: BaseNetwork) -> str:
    """Changes when a weight does, and with nothing else in the checkpoint."""
    return _hash({name: tensor.float().numpy() for name, tensor in network.state_dict().items()})


def prior_hash(prior: Path) -> str | None:
    """Of the weights of a learned prior, "learned" or a file; None for "none".

    Raises InputError if the file is no prior.
    """
    network = named_prior(str(prior))
    return None if network is None else _hash(network.weights)


def _hash(weights: Mapping[str, NDArray[Any]]) -> str:
    digest = hashlib.sha256()
    for name, array in sorted(weights.items()):
        digest.update(name.encode() + array.tobytes())
    return digest.hexdigest()[:16]
