"""`tso refine --point-confidence`: what the masks determine, in the file, in words and as JSON."""

import numpy as np
import pytest
import trimesh

from tso_cli.io.clouds import read_cloud
from tso_cli.io.ply import PlyFile

POINTS = ("initial.ply", "mask.png")


def test_the_cloud_has_a_confidence(folder, refine):
    refine(*POINTS, "-o", "plain.ply")
    refine(*POINTS, "--point-confidence", "-o", "out.ply")
    np.testing.assert_array_equal(read_cloud("out.ply").points, read_cloud("plain.ply").points)
    loaded = trimesh.load("out.ply").metadata["_ply_raw"]["vertex"]["data"]
    assert 0.0 <= loaded["confidence"].min() < loaded["confidence"].max() <= 1.0


def test_a_mesh_has_a_confidence_at_its_vertices(folder, refine):
    trimesh.creation.icosphere(subdivisions=2, radius=0.4).export("ball.ply")
    refine("ball.ply", "mask.png", "--point-confidence", "-o", "out.ply", "--accept-doubtful")
    data = (folder / "out.ply").read_bytes()
    vertices = PlyFile(data, folder / "out.ply").vertex
    assert (vertices.count, "confidence" in vertices.properties) == (162, True)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (
            ["-o", "out.npy"],
            "out.npy: the suffix is '.npy', expected .ply to hold --point-confidence; "
            "write another file: -o out.ply",
        ),
        (
            ["--preset", "paper"],
            "--point-confidence is for --mode points and --preset best, found --mode points and "
            "--preset paper",
        ),
    ],
)
def test_what_cannot_hold_a_confidence_is_refused_before_any_file_is_read(
    folder, refine, words, message
):
    run = refine("missing.ply", "mask.png", "--point-confidence", *words)
    assert run.code == 2
    assert run.err.splitlines() == [f"tso: error: {message}"]
