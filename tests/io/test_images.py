"""Masks of every kind mean the same; images come upright; other files are refused in a line."""

import os
import struct
import warnings
import zlib

import numpy as np
import pytest
from PIL import Image

from tests.corruption import assert_reads_or_refuses, assert_refused, repair_png
from tso_cli.io.depth_maps import read_depth
from tso_cli.io.images import (
    PIXEL_LIMIT,
    has_alpha,
    orientation,
    read_image,
    write_image,
)
from tso_cli.io.masks import read_mask

pytestmark = pytest.mark.filterwarnings("error")
SHAPE = np.zeros((6, 9), dtype=bool)
SHAPE[1:4, 2:7] = True
SHAPE[4, 2] = True
SOFT = np.linspace(0, 255, 54).round().astype(np.uint8).reshape(6, 9)


GREY = SHAPE.astype(np.uint8) * 255


def palette(colours, index=SHAPE):
    image = Image.fromarray(index.astype(np.uint8), "P")
    image.putpalette([c for colour in colours for c in colour])
    return image


def with_alpha(mode):
    image = Image.new("RGB" if mode == "RGBA" else "L", (9, 6), "white")
    image.putalpha(Image.fromarray(GREY))
    return image


HARD = {
    "1-bit": lambda: Image.fromarray(SHAPE),
    "8-bit": lambda: Image.fromarray(GREY),
    "16-bit": lambda: Image.fromarray(SHAPE.astype(np.uint16) * 65535),
    "RGB": lambda: Image.fromarray(GREY).convert("RGB"),
    "one colour": lambda: Image.fromarray(np.stack([0 * GREY, 0 * GREY, GREY], axis=2)),
    "RGBA": lambda: with_alpha("RGBA"),
    "LA": lambda: with_alpha("LA"),
    "opaque RGBA": lambda: Image.fromarray(GREY).convert("RGBA"),
    "white and black palette": lambda: palette([(255, 255, 255), (0, 0, 0)], ~SHAPE),
    "label palette": lambda: palette([(0, 0, 0), (128, 0, 0), (0, 128, 0)], SHAPE * 2),
    "label palette, bright outside": lambda: palette([(255, 255, 0), (0, 0, 128)]),
    "palette that shows labels alike": lambda: palette([(0, 0, 0), (0, 0, 0)]),
}


def saved(tmp_path, image, name="mask.png", **options):
    image.save(tmp_path / name, **options)
    return tmp_path / name


@pytest.mark.parametrize("kind", HARD)
def test_a_mask_means_the_same_in_every_kind_of_png(tmp_path, kind):
    mask = read_mask(saved(tmp_path, HARD[kind]()))
    assert mask.dtype == np.float32
    assert np.array_equal(mask, SHAPE.astype(np.float32))


@pytest.mark.parametrize("suffix", [".tif", ".bmp", ".gif", ".pgm"])
def test_a_mask_means_the_same_in_every_format_and_of_several_frames_the_first_counts(
    tmp_path, suffix
):
    frames = (
        {"save_all": True, "append_images": [Image.new("L", (9, 6))]} if suffix == ".gif" else {}
    )
    assert np.array_equal(
        read_mask(saved(tmp_path, HARD["8-bit"](), "mask" + suffix, **frames)), SHAPE
    )


def test_soft_values_are_kept_and_a_mask_of_one_value_is_left_to_the_view_to_refuse(tmp_path):
    wide = SOFT.astype(np.uint16) * 257 + 3
    wide[5, 8] = 65535
    alpha = Image.new("RGB", (9, 6), "red")
    alpha.putalpha(Image.fromarray(SOFT))
    for image, expected in [
        (Image.fromarray(SOFT), SOFT / 255),
        (Image.fromarray(SOFT).convert("RGB"), SOFT / 255),
        (Image.fromarray(wide), wide / 65535),
        (alpha, SOFT / 255),
        (palette([(i, i, i) for i in range(256)], SOFT), SOFT / 255),
        (Image.new("L", (9, 6)), 0),
        (Image.new("L", (9, 6), 255), 1),
        (Image.new("RGBA", (9, 6)), 0),
    ]:
        assert np.allclose(read_mask(saved(tmp_path, image)), expected, rtol=0, atol=1e-7)
    unit = (SOFT / np.float32(255)).astype(np.float32)
    assert np.array_equal(read_mask(saved(tmp_path, Image.fromarray(unit), "mask.tif")), unit)


@pytest.mark.parametrize("hole", [255, 200, 0])
def test_an_alpha_channel_that_leaves_out_hardly_a_pixel_is_no_mask(tmp_path, hole):
    picture = np.repeat(np.uint8(255 * SHAPE)[..., None], 3, axis=2).repeat(10, 0).repeat(10, 1)
    alpha = np.full(picture.shape[:2], 255, np.uint8)
    alpha[: 1 if hole == 0 else None, : 2 if hole == 0 else None] = hole
    image = Image.fromarray(np.dstack([picture, alpha]))
    assert np.array_equal(read_mask(saved(tmp_path, image)), picture[..., 0] / np.float32(255))


def test_labels_of_0_and_1_are_read_as_such_with_a_warning(tmp_path):
    saved(tmp_path, Image.fromarray(SHAPE.astype(np.uint8)))
    np.save(tmp_path / "mask.npy", SHAPE.astype(np.int64))
    for name in ("mask.png", "mask.npy"):
        with pytest.warns(UserWarning, match=rf"{name}: its largest value is 1, read as labels"):
            assert np.array_equal(read_mask(tmp_path / name), SHAPE)


def test_a_colour_declared_transparent_is_outside(tmp_path):
    rgb = np.full((6, 9, 3), 90, dtype=np.uint8)
    rgb[~SHAPE] = (255, 0, 255)
    path = saved(tmp_path, Image.fromarray(rgb), transparency=(255, 0, 255))
    assert np.array_equal(read_mask(path), SHAPE)
    assert read_image(path).shape == (6, 9, 4)
    path = saved(tmp_path, palette([(9, 9, 9), (50, 0, 0)]), transparency=0)
    assert np.array_equal(read_mask(path), SHAPE)


def test_arrays_are_masks_too(tmp_path):
    for array in (SHAPE, SHAPE.astype(np.float64), SHAPE.astype(np.int64) * 255):
        np.save(tmp_path / "m.npy", array)
        assert np.array_equal(read_mask(tmp_path / "m.npy"), SHAPE), array.dtype


@pytest.mark.parametrize(
    ("read", "array", "message"),
    [
        (read_mask, np.array([[0.0, np.nan]]), "values span nan to nan, expected 0 to 1"),
        (
            read_mask,
            np.array([[0x7F800001]], np.uint32).view(np.float32),
            "values span nan to nan",
        ),  # a signalling NaN
        (read_mask, np.array([[0.0, 1.5]]), "values span 0 to 1.5, expected 0 to 1"),
        (read_mask, np.array([[0, -1]]), "smallest value is -1"),
        (read_mask, np.array([[0, 70000]]), "largest value is 70000"),
        (read_mask, np.zeros((2, 2, 3)), r"float64 \[2, 2, 3\], expected a mask \[H, W\]"),
        (read_mask, np.zeros((0, 2)), r"\[0, 2\]"),
        (read_depth, np.zeros((4, 4)), "holds no depth > 0"),
        (read_depth, np.full((4, 4), -2.0), "smallest depth is -2"),
        (read_depth, np.ones((4, 4, 3)), r"float64 \[4, 4, 3\], expected a depth map \[H, W\]"),
        (read_depth, np.ones((4, 4), bool), "expected a depth map"),
    ],
)
def test_arrays_that_are_no_masks_or_depth_maps_are_refused(tmp_path, read, array, message):
    np.save(tmp_path / "m.npy", array)
    assert_refused(rf"m\.npy: .*{message}", read, tmp_path / "m.npy")


@pytest.mark.parametrize("orientation", range(1, 9))
def test_images_and_masks_are_turned_as_the_camera_noted(tmp_path, orientation):
    """Each file stores the pixels so that, turned as noted, the same upright picture appears."""
    upright = np.arange(54, dtype=np.uint8).reshape(6, 9) * 4
    # The eight ways a camera may be held (EXIF tag 274), each undone.
    stored = {
        1: upright, 2: upright[:, ::-1], 3: upright[::-1, ::-1], 4: upright[::-1], 5: upright.T,
        6: np.rot90(upright, 1), 7: upright[::-1, ::-1].T, 8: np.rot90(upright, -1),
    }[orientation]  # fmt: skip
    exif = Image.Exif()
    exif[274] = orientation
    for suffix in (".png", ".tif"):
        path = saved(
            tmp_path, Image.fromarray(np.ascontiguousarray(stored)), "a" + suffix, exif=exif
        )
        assert np.array_equal(read_image(path)[..., 0], upright), suffix
        assert np.array_equal(np.rint(read_mask(path) * 255), upright), suffix


def test_images_become_8_bit_colours(tmp_path):
    rgb = np.random.default_rng(0).integers(0, 256, (6, 9, 3), dtype=np.uint8)
    for array in (rgb, np.dstack([rgb, SOFT])):
        assert np.array_equal(read_image(saved(tmp_path, Image.fromarray(array))), array)
    for array in (SOFT, SOFT.astype(np.uint16) * 257):
        assert np.array_equal(
            read_image(saved(tmp_path, Image.fromarray(array))), np.dstack([SOFT] * 3)
        )
    assert np.array_equal(read_image(saved(tmp_path, HARD["1-bit"]()))[..., 1], SHAPE * 255)
    assert read_image(saved(tmp_path, Image.fromarray(rgb).convert("CMYK"), "a.jpg")).shape == (
        6,
        9,
        3,
    )


def test_what_is_written_reads_back(tmp_path):
    rgba = np.random.default_rng(0).integers(0, 255, (6, 9, 4), dtype=np.uint8)
    write_image(tmp_path / "a.png", rgba)
    assert np.array_equal(read_image(tmp_path / "a.png"), rgba)
    for array, mask in ((SHAPE, SHAPE), (SOFT, SOFT / np.float32(255))):
        write_image(tmp_path / "a.png", array, overwrite=True)
        assert np.array_equal(read_mask(tmp_path / "a.png"), mask)


def png_of(width, height, rows=b""):
    """A PNG header that promises ``width`` x ``height`` grey pixels, and compressed zeros."""

    def chunk(name, body):
        return (
            struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body))
        )

    header = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0))
    return b"\x89PNG\r\n\x1a\n" + header + chunk(b"IDAT", rows) + chunk(b"IEND", b"")


@pytest.mark.parametrize("side", [10_001, 32_000, 2**31 - 1])
@pytest.mark.parametrize("read", [read_mask, read_image])
def test_a_billion_pixels_in_a_kilobyte_are_refused_without_decoding(
    tmp_path, monkeypatch, side, read
):
    monkeypatch.setattr(Image.Image, "load", lambda *_: pytest.fail("decoded"))
    (tmp_path / "bomb.png").write_bytes(png_of(side, side, zlib.compress(bytes(100_000))))
    assert (tmp_path / "bomb.png").stat().st_size < 1024
    assert_refused(rf"bomb\.png: .*expected at most {PIXEL_LIMIT:,}", read, tmp_path / "bomb.png")


def test_a_large_picture_within_the_limit_passes_without_warning(tmp_path, monkeypatch):
    """Pillow warns of pictures over a limit of its own, which is lower."""
    assert Image.MAX_IMAGE_PIXELS < PIXEL_LIMIT
    path = saved(tmp_path, HARD["8-bit"]())
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 50)
    assert np.array_equal(read_mask(path), SHAPE)


@pytest.mark.parametrize("read", [read_mask, read_image])
@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("cut.png", png_of(40, 40, zlib.compress(bytes(1640))[:-9]), "is not readable as"),
        ("text.png", b"hello", "is not a readable image"),
        ("none.png", png_of(0, 5), "is not"),
        # A format whose reader would start another program.
        (
            "page.eps",
            b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n%%EndComments\n",
            "is not a readable image",
        ),
    ],
)
def test_files_that_are_no_images_are_refused(tmp_path, read, name, content, message):
    (tmp_path / name).write_bytes(content)
    assert_refused(rf"{name}: .*{message}", read, tmp_path / name)


DAMAGED = {
    **{f"{kind}.png": HARD[kind] for kind in ("16-bit", "RGBA", "label palette")},
    "palette.gif": HARD["label palette"],
    "photo.jpg": HARD["RGB"],
    "float.tif": lambda: Image.fromarray(SHAPE.astype(np.float32)),
    "grey.bmp": HARD["8-bit"],
}


@pytest.mark.parametrize("name", [*DAMAGED, "array.npy"])
@pytest.mark.parametrize("read", [read_mask, read_image])
def test_any_damage_is_read_or_refused_in_one_line(tmp_path, read, name):
    exif = Image.Exif()
    exif[274] = 6
    if name == "array.npy":
        np.save(tmp_path / name, SOFT)
    else:
        saved(
            tmp_path,
            DAMAGED[name](),
            name,
            **({"exif": exif} if name.endswith((".jpg", ".png", ".tif")) else {}),
        )

    def checked(path):
        array = read(path)
        if read is read_mask:
            assert array.dtype == np.float32
            assert array.ndim == 2
            assert 0 <= array.min() <= array.max() <= 1
        else:
            assert array.dtype == np.uint8
            assert array.shape[2:] in ((3,), (4,))

    repair = repair_png if name.endswith(".png") else None
    was_read, refused = assert_reads_or_refuses(checked, tmp_path / name, count=100, repair=repair)
    assert was_read > 3 or (name == "array.npy" and read is read_image)
    assert refused > 8


def test_a_pipe_is_refused_and_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "a.png")
    assert orientation(tmp_path / "a.png") == 1
    assert not has_alpha(tmp_path / "a.png")
    assert_refused("is not a regular file", read_image, tmp_path / "a.png")


def test_a_picture_too_large_says_how_many_pixels_it_has(tmp_path, monkeypatch):
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 100)
    Image.new("L", (20, 20)).save(tmp_path / "a.png")
    assert_refused("has 400 pixels, expected at most", read_image, tmp_path / "a.png")
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 300)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert orientation(tmp_path / "a.png") == 1
