"""`tso refine --point-confidence`: what the masks determine, in the file, in words and as JSON."""

import numpy as np
import pytest
import trimesh

from tso_cli.commands.refine_report import words_of_best_view
from tso_cli.diagnosis.best_view import BestView
from tso_cli.io.clouds import read_cloud
from tso_cli.io.ply import PlyFile

POINTS = ("initial.ply", "mask.png")


def test_the_cloud_has_a_confidence_and_a_line_says_where_to_look_next(folder, refine):
    plain = refine(*POINTS, "-o", "plain.ply", "--json").document
    run = refine(*POINTS, "--point-confidence", "-o", "out.ply")
    assert run.out.splitlines()[4].startswith("  next   a mask from ")
    assert f"(determined: {plain['determined']:.2f} to about 0." in run.out
    assert plain["best_view"] is None
    np.testing.assert_array_equal(read_cloud("out.ply").points, read_cloud("plain.ply").points)
    loaded = trimesh.load("out.ply").metadata["_ply_raw"]["vertex"]["data"]
    assert 0.0 <= loaded["confidence"].min() < loaded["confidence"].max() <= 1.0


def test_the_document_has_the_camera_of_the_view_that_would_help_most(folder, refine):
    document = refine(*POINTS, "--point-confidence", "--json").document
    best, camera = document["best_view"], document["camera"]
    assert document["determined"] < best["determined"] <= 1.0
    assert np.shape(best["R"]) == (3, 3)
    distance = [np.linalg.norm(one["t"]) for one in (best, camera)]
    assert distance[0] == pytest.approx(distance[1], rel=0.05)


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
            "--point-confidence is for mode points with preset best, found points with paper",
        ),
    ],
)
def test_what_cannot_hold_a_confidence_is_refused_before_any_file_is_read(
    folder, refine, words, message
):
    run = refine("missing.ply", "mask.png", "--point-confidence", *words)
    assert run.code == 2
    assert run.err.splitlines() == [f"tso: error: {message}"]


@pytest.mark.parametrize(
    ("azimuth", "elevation", "words"),
    [
        (90, 0, "90 degrees to the right"),
        (-45, 45, "45 degrees to the left and 45 degrees above"),
        (180, -45, "behind and 45 degrees below"),
        (0, 90, "90 degrees above"),
    ],
)
def test_directions_are_said_as_seen_from_the_first_camera(chair, azimuth, elevation, words):
    best = BestView(azimuth, elevation, chair.camera, 0.5)
    assert words_of_best_view(best) == f"a mask from {words} would help most"
