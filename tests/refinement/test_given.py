"""What notebooks and pipelines hand over: other types, shapes and scales of the same numbers."""

import sys

import numpy as np
import pytest
import torch
from PIL import Image

from tests.corruption import assert_refused
from tests.scenes import block
from tso_cli import (
    Camera,
    RefineConfig,
    View,
    chamfer,
    fit_camera,
    read_mask,
    refine,
    refine_batch,
    write_mask,
)

POINTS = np.random.default_rng(0).uniform(-0.3, 0.3, (40, 3))
CAMERA = Camera.canonical(64, 64)
MASK = block(np.s_[21:32, 25:41])
BYTES = (255 * MASK).astype(np.uint8)
VIEW = View(MASK, CAMERA)
FEW = {"steps": 2, "symmetry": "none", "accept_doubtful": True}
EXPECTED = refine(POINTS, MASK, CAMERA, RefineConfig(**FEW)).points


def with_alpha():
    picture = Image.new("RGB", (64, 64), (90, 80, 70))
    picture.putalpha(Image.fromarray(BYTES))
    return picture


MASKS = {
    "bytes": BYTES,
    "a tensor of bytes": torch.from_numpy(BYTES),
    "floats to 255": BYTES.astype("f4"),
    "[H, W, 1]": BYTES[..., None],
    "a picture": Image.fromarray(BYTES),
    "a picture of bits": Image.fromarray(BYTES).convert("1"),
    "a cut-out": with_alpha(),
    "bfloat16": torch.from_numpy(MASK).bfloat16(),
}


@pytest.mark.parametrize("name", MASKS)
def test_a_mask_is_taken_as_arrays_and_pictures_have_it(tmp_path, name):
    result = refine(POINTS, MASKS[name], CAMERA, FEW)
    np.testing.assert_array_equal(result.points, EXPECTED)
    np.testing.assert_array_equal(View(MASKS[name], CAMERA).mask, MASK)
    write_mask(tmp_path / "mask.png", MASKS[name])
    np.testing.assert_array_equal(read_mask(tmp_path / "mask.png"), MASK)


def test_a_camera_is_fitted_to_a_mask_of_bytes():
    fitted = [fit_camera(POINTS, mask, K=CAMERA.K).camera for mask in (MASK, BYTES)]
    np.testing.assert_array_equal(fitted[0].R, fitted[1].R)


def test_labels_and_colours_are_no_mask():
    assert_refused("span 0 to 2, expected 0 to 1", View, 2 * (MASK > 0), CAMERA)
    assert_refused("expected \\[H, W\\]", View, Image.new("RGB", (64, 64)), CAMERA)


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16, torch.float32, torch.float64])
def test_the_points_of_a_tensor_are_a_tensor_again(dtype):
    given = torch.from_numpy(POINTS).to(dtype).requires_grad_()
    result = refine(given, MASK, CAMERA, FEW)
    assert (result.points.dtype, result.points.device) == (dtype, given.device)
    expected = refine(given.detach().double().numpy(), MASK, CAMERA, FEW)
    assert torch.equal(result.points, torch.from_numpy(expected.points).to(dtype))
    assert torch.equal(result.initial, given.detach())
    assert chamfer(result.points, given).chamfer > 0.0
    (of_batch,) = refine_batch([(given, VIEW)], FEW)
    assert torch.equal(of_batch.points, result.points)


def test_whole_numbers_are_not_rounded_again():
    given = torch.from_numpy(np.rint(1000 * POINTS)).int()
    camera = Camera(CAMERA.K, CAMERA.R, 1000 * CAMERA.t, 64, 64)
    assert refine(given, MASK, camera, FEW).points.dtype == torch.float32


def test_arrays_and_lists_stay_arrays_and_need_no_torch(monkeypatch):
    monkeypatch.delitem(sys.modules, "torch")
    for given in (POINTS, POINTS.tolist(), POINTS[None]):
        points = refine(given, MASK, CAMERA, FEW).points
        assert type(points) is np.ndarray
        np.testing.assert_array_equal(points, EXPECTED)
    assert "torch" not in sys.modules


def test_points_that_are_not_finite_are_left_out_of_a_cloud_with_a_word():
    holed = np.insert(POINTS, 7, [[np.nan, 0, 0], [0, np.inf, 0]], 0)
    with pytest.warns(UserWarning, match="points: 2 of 42 have a NaN or infinite coordinate"):
        np.testing.assert_array_equal(refine(holed, MASK, CAMERA, FEW).points, EXPECTED)
    assert_refused("point 7 has a NaN", refine, holed, MASK, CAMERA, faces=[[0, 1, 2]])
    assert_refused("point 0 has a NaN", refine, POINTS * np.nan, MASK, CAMERA)


def test_numbers_of_numpy_and_columns_are_numbers():
    camera = Camera(CAMERA.K, CAMERA.R, CAMERA.t[:, None], np.int64(64), np.float64(64.0))
    np.testing.assert_array_equal(camera.t, CAMERA.t)
    result = refine(POINTS, MASK, camera, {**FEW, "steps": np.int64(2)})
    np.testing.assert_array_equal(result.points, EXPECTED)


def test_a_config_may_be_a_dictionary():
    assert_refused("config has .stepz., expected mode, preset, prior", refine, POINTS, MASK,
                   CAMERA, {"stepz": 5})  # fmt: skip
    assert_refused("config is of type list, expected a RefineConfig", refine, POINTS, MASK,
                   CAMERA, [5])  # fmt: skip
    assert refine(POINTS, MASK, CAMERA, {"steps": 0}).settings.steps == 0


def test_clouds_in_one_array_are_scenes():
    clouds = torch.from_numpy(np.stack([POINTS, 0.9 * POINTS])).float()
    alone = [refine(cloud, VIEW, config=FEW).points for cloud in clouds]
    for scenes in ((clouds, VIEW), (clouds, [VIEW, VIEW])):
        for result, expected in zip(refine_batch(scenes, FEW), alone, strict=True):
            assert torch.equal(result.points, expected)
    assert_refused("found 3 views for 2 clouds", refine_batch, (clouds, [VIEW] * 3))
