"""A folder of meshes, and `tso render` run in this process."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from tso_cli.geometry.camera import intrinsics
from tso_cli.io.meshes import Mesh, write_mesh
from tso_cli.render import viewpoints


@pytest.fixture
def tso_render(tso):
    return lambda source, output, *options: tso("render", source, "-o", output, *options)


def box(sides=(1.0, 1.0, 1.0), centre=(0.0, 0.0, 0.0)):
    """A closed box of 12 triangles."""
    made = trimesh.creation.box(sides)
    return Mesh(np.array(made.vertices) + centre, np.array(made.faces))


def joined(*parts):
    starts = np.cumsum([0] + [len(part.vertices) for part in parts])
    faces = [part.faces + start for part, start in zip(parts, starts[:-1], strict=True)]
    return Mesh(np.concatenate([part.vertices for part in parts]), np.concatenate(faces))


def stool():
    """Not convex, not symmetric: a seat, three legs and a post."""
    legs = [box((0.1, 0.6, 0.1), (x, -0.35, z)) for x, z in ((-0.3, -0.2), (0.3, -0.2), (0.1, 0.2))]
    return joined(box((0.8, 0.1, 0.5)), *legs, box((0.1, 0.5, 0.1), (-0.3, 0.3, 0.0)))


def look_at(azimuth, elevation, distance, size, focal):
    """`viewpoints.look_at` with another focal length, px."""
    camera = viewpoints.look_at(azimuth, elevation, distance, size)
    return replace(camera, K=intrinsics(focal, *size))


@pytest.fixture
def meshes(tmp_path):
    folder = tmp_path / "meshes"
    (folder / "chair").mkdir(parents=True)
    write_mesh(folder / "chair" / "a.ply", stool())
    write_mesh(folder / "chair" / "b.ply", box((1.0, 0.3, 0.5)))
    write_mesh(folder / "c.ply", box())
    return folder
