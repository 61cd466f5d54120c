"""`tso refine --mask-error`, and the causes that `--check` names."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.scenes import small
from tso_cli.io.cameras import CameraRecord, write_cameras
from tso_cli.io.clouds import read_cloud

GROWN = ("target.ply", "grown.png", "--camera", "grown.json")
STEPS = ("--steps", "2")


@pytest.fixture
def grown(folder, chair):
    """The chair of 24 px in grown.png, with an outline 2 px too far out; its camera."""
    view = small(chair, 24, grown=2)
    Image.fromarray(np.uint8(view.mask * 255.0)).save("grown.png")
    write_cameras(Path("grown.json"), [CameraRecord(view.camera, Path("grown.png"))])
    return view


def _points(file):
    return read_cloud(Path(file)).points


def test_within_the_error_of_its_mask_a_right_cloud_stays(grown, refine):
    assert "(doubtful)" in refine(*GROWN, "-o", "by-default.ply").out
    assert "(left)" in refine(*GROWN, "--mask-error", "3", "-o", "out.ply").out
    np.testing.assert_array_equal(_points("out.ply"), _points("target.ply"))


def test_a_batch_and_a_record_have_the_error_of_the_masks(grown, refine, tso):
    alone = refine(*GROWN, *STEPS, "--mask-error", "1.5", "--record", "-o", "alone.ply")
    assert alone.code == 0
    document = json.loads(Path("alone.record.json").read_text())
    assert document["options"]["mask_error"] == 1.5
    assert refine("--config", "alone.record.json", *GROWN[:2], "-o", "again.ply").code == 0
    Path("items.csv").write_text(
        "cloud,mask,camera,steps,mask-error,output\n"
        "target.ply,grown.png,grown.json,2,1.5,item.ply\n"
        "target.ply,grown.png,grown.json,2,,default.ply\n"
    )
    # Without the error a result is doubtful.
    assert tso("batch", "items.csv", "-o", "out").code in (0, 3)
    for file in ("again.ply", "out/item.ply"):
        np.testing.assert_array_equal(_points(file), _points("alone.ply"))
    verdicts = [
        json.loads(Path(f"out/{name}.record.json").read_text())["verdict"]
        for name in ("item", "default")
    ]
    assert verdicts == [document["verdict"], "doubtful"]
    assert verdicts[0] != verdicts[1]


@pytest.mark.parametrize("error", ["0", "-1", "nan", "inf"])
def test_an_error_that_is_no_length_is_refused_before_any_file_is_read(folder, refine, error):
    message = refine("none.ply", "none.png", "--mask-error", error).refusal
    assert f"--mask-error is {error}, expected a finite number, more than 0" in message


def test_the_network_modes_have_no_contours_to_be_wrong(folder, refine):
    message = refine("image.png", "mask.png", "--mode", "latent", "--mask-error", "1").refusal
    assert "--mask-error 1 is for --mode points, found --mode latent" in message


def test_a_check_names_the_cause_that_a_refinement_names(folder, refine, chair):
    """A focal length that is 10 % too long."""
    camera = json.loads(Path("camera.json").read_text())
    for i in range(2):
        camera["K"][i][i] *= 1.1
    Path("camera.json").write_text(json.dumps(camera))
    checked = refine("target.ply", "mask.png", "--check", "--json").document
    document = refine("target.ply", "mask.png", "--json", "-o", "out.ply").document
    assert "the focal length" in str(document["suspects"])
    for key in ("suspects", "verdict", "reason"):
        assert checked[key] == document[key]
