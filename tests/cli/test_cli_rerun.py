"""`--rerun`: a recording of the optimisation, as the viewer rerun reads it."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("rerun")

CHUNK = re.compile(r"with (\d+) rows .* - (/\S+) - data columns: \[(.*)\]")


def _read(path):
    """What rerun finds in a recording: (name, column) -> rows."""
    command = [sys.executable, "-m", "rerun", "rrd", "print", path]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    found = {}
    for rows, name, columns in CHUNK.findall(done.stdout):
        for column in columns.split():
            found[name, column] = found.get((name, column), 0) + int(rows)
    return found


def test_a_recording_has_the_points_of_every_step_and_the_picture_of_each_view(tso, folder, views):
    shown = tso("refine", "initial.ply", *views, "--camera", "views.json", "--steps", "9",
                "--rerun", "a.rrd", "-o", "a.ply")  # fmt: skip
    assert shown.code == 0
    found = _read("a.rrd")
    assert found["/scene/control_points", "Points3D:positions"] == 9
    assert found["/loss", "Scalars:scalars"] == 9
    for number in (1, 2, 3):
        assert found[f"/scene/view_{number}", "Pinhole:image_from_camera"] == 1
        assert found[f"/scene/view_{number}/picture", "EncodedImage:blob"] == 1
    assert found["/scene/start", "Points3D:positions"] == 1
    assert found["/scene/result", "Points3D:colors"] == 1
    assert found["/words", "TextDocument:text"] == 1


def test_a_mesh_is_recorded_as_a_mesh_and_an_input_is_never_replaced(tso, folder):
    from tso_cli.io.shipped import examples_folder

    mesh = next((examples_folder() / "meshes/chair").glob("*.ply"))
    words = ("refine", mesh, "mask.png", "--steps", "3", "-o")
    assert tso(*words, "m.ply", "--rerun", "m.rrd").code == 0
    found = _read("m.rrd")
    assert found["/scene/result", "Mesh3D:triangle_indices"] == 1
    before = Path("m.rrd").read_bytes()
    assert "m.rrd: exists already" in tso(*words, "n.ply", "--rerun", "m.rrd").refusal
    assert "expected .rrd" in tso(*words, "n.ply", "--rerun", "m.html").refusal
    assert Path("m.rrd").read_bytes() == before
