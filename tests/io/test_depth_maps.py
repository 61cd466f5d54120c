"""Depth maps as sensors and networks write them."""

import numpy as np
import pytest
from PIL import Image

from tests.corruption import assert_refused
from tso_cli.io.depth_maps import confidence_of, read_depth
from tso_cli.io.images import read_image
from tso_cli.io.views import ViewFiles, load_views

DEPTH = np.array([[0.5, 2.0, 3.0], [1.5, 2.5, 4.0]])


def png(path, values):
    path.parent.mkdir(exist_ok=True)
    Image.fromarray(np.asarray(values)).save(path)
    return path


def test_a_depth_map_keeps_sixteen_bits_and_its_scale(tmp_path):
    values = np.array([[0, 1, 1000], [2345, 40000, 65534]], np.uint16)
    wanted = np.where(values == 0, np.nan, values / 1000.0)
    np.testing.assert_allclose(read_depth(png(tmp_path / "depth.png", values), 0.001), wanted)


def test_what_sensors_write_for_unknown_becomes_nan(tmp_path):
    unknown = np.array([[0.0, np.nan, np.inf, -1.0, 65535.0]], np.float32)
    floats = np.vstack([unknown, [[0.5, 2.0, 3.0, 4.0, 5.0]]]).astype(np.float32)
    wanted = np.vstack([[[np.nan] * 5], floats[1:]])
    np.save(tmp_path / "depth.npy", floats)
    Image.fromarray(floats).save(tmp_path / "depth.tiff")
    header = f"Pf\n{floats.shape[1]} {floats.shape[0]}\n-1.0\n".encode()
    (tmp_path / "depth.pfm").write_bytes(header + floats[::-1].astype("<f4").tobytes())
    for name in ("depth.npy", "depth.tiff", "depth.pfm"):
        np.testing.assert_allclose(read_depth(tmp_path / name), wanted)
    # Inverse depths may be below 0, and fill all 16 bits.
    signed = read_depth(tmp_path / "depth.npy", signed=True)
    np.testing.assert_array_equal(signed[0, 3:], [-1.0, 65535.0])


@pytest.mark.parametrize(
    "arrays",
    [
        {"depth": DEPTH[None], "conf": np.ones((1, 2, 3))},  # Depth Anything 3
        {"depth_map": DEPTH[None, ..., None]},  # VGGT
        {"points": np.stack([0 * DEPTH, 0 * DEPTH, DEPTH], -1), "intrinsics": np.eye(3)},  # MoGe
    ],
)
def test_depths_of_networks_are_read_from_archives(tmp_path, arrays):
    np.savez(tmp_path / "a.npz", **arrays)
    np.testing.assert_array_equal(read_depth(tmp_path / "a.npz"), DEPTH)


def test_depths_outside_of_the_mask_of_an_archive_are_unknown(tmp_path):
    np.savez(tmp_path / "a.npz", depth=DEPTH, mask=DEPTH > 2.0)
    np.testing.assert_array_equal(
        read_depth(tmp_path / "a.npz"), np.where(DEPTH > 2.0, DEPTH, np.nan)
    )


def test_an_archive_without_one_depth_map_says_what_it_holds(tmp_path):
    np.savez(tmp_path / "a.npz", colour=DEPTH, conf=DEPTH)
    assert_refused(
        r"a\.npz: holds colour, conf, expected an array called depth", read_depth,
        tmp_path / "a.npz",
    )  # fmt: skip
    np.savez(tmp_path / "a.npz", depth=np.stack([DEPTH, DEPTH]))
    assert_refused(r"float64 \[2, 2, 3\], expected a depth map", read_depth, tmp_path / "a.npz")


@pytest.mark.parametrize(
    ("depth", "confidence"),
    [("depth/000001.png", "confidence/000001.png"), ("depth_00001.png", "conf_00001.png")],
)
@pytest.mark.parametrize("levels", [(0, 1, 2), (0, 127, 255)])
def test_depths_of_low_confidence_are_unknown(tmp_path, depth, confidence, levels):
    path = png(tmp_path / depth, np.rint(1000.0 * DEPTH).astype(np.uint16))
    assert confidence_of(path) is None
    png(tmp_path / confidence, np.array([levels, levels], np.uint8))
    wanted = DEPTH.copy()
    wanted[:, 0] = np.nan
    np.testing.assert_allclose(read_depth(path, 0.001), wanted)
    png(tmp_path / confidence, np.ones((4, 4), np.uint8))
    assert_refused(r"0*1\.png: is 4x4, the depth map .* is 3x2, expected", read_depth, path, 0.001)


@pytest.mark.parametrize("read", [read_depth, read_image])
def test_openexr_is_refused_with_the_way_to_convert_it(tmp_path, read):
    (tmp_path / "a.exr").write_bytes(b"\x76\x2f\x31\x01" + bytes(200))
    assert_refused(r"a\.exr: is an OpenEXR file, .* numpy\.save", read, tmp_path / "a.exr")


def test_a_depth_map_of_another_size_is_scaled_to_its_mask_and_the_run_says_so(tmp_path):
    inside = np.zeros((720, 960), np.uint8)
    inside[200:500, 300:600] = 255
    mask = png(tmp_path / "mask.png", inside)
    row, column = np.mgrid[:192, :256]
    depth = png(tmp_path / "depth/1.png", (2000 + 4 * column + 2 * row).astype(np.uint16))
    png(tmp_path / "confidence/1.png", np.where(column < 100, 0, 2).astype(np.uint8))
    (view,), (origin,) = load_views(ViewFiles([mask], depth=[depth], depth_scale=0.001))
    # A pixel of the map is 3.75 pixels of the mask; centres lie at whole numbers.
    at = (np.array([300, 500]) + 0.5) / 3.75 - 0.5
    assert view.depth[300, 500] == pytest.approx(2.0 + 0.004 * at[1] + 0.002 * at[0], abs=0.003)
    assert np.isnan(view.depth[:, :374]).all()
    assert origin.notes == (
        "1.png scaled from 256x192",
        f"1.png without the low confidence of {tmp_path / 'confidence/1.png'}",
    )
    turned = png(tmp_path / "turned.png", np.full((256, 192), 2000, np.uint16))
    assert_refused(
        r"turned\.png: is 192x256, the mask .* is 960x720", load_views,
        ViewFiles([mask], depth=[turned]),
    )  # fmt: skip
