"""Masks as segmenters and labelling tools write them."""

import json
import warnings
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.corruption import assert_reads_or_refuses, assert_refused
from tso_cli.io.images import orientation
from tso_cli.io.masks import MaskChoice, labels_of, masks_in, read_mask
from tso_cli.io.views import ViewFiles, load_views

FILES = Path(__file__).with_name("files") / "masks"
ONE = np.zeros((40, 60), bool)
ONE[8:20, 10:30] = True
OTHER = np.zeros((40, 60), bool)
OTHER[24:36, 34:56] = True
LABELS = (ONE + 2 * OTHER).astype(np.uint8)


def saved(path, array, **options):
    Image.fromarray(array).save(path, **options)
    return path


def palette(labels):
    image = Image.fromarray(labels, "P")
    image.putpalette([0, 0, 0, 128, 0, 0, 0, 128, 0, 128, 128, 0])
    return image


def test_of_several_labels_one_must_be_chosen_and_is_then_taken(tmp_path):
    palette(LABELS).save(tmp_path / "palette.png")
    colours = np.zeros((*LABELS.shape, 3), np.uint8)
    colours[ONE], colours[OTHER] = (140, 25, 255), (20, 60, 10)
    paths = {
        saved(tmp_path / "grey.png", LABELS): ("1", "2"),
        saved(tmp_path / "sixteen.png", LABELS.astype(np.uint16) * 1000): ("1000", "2000"),
        tmp_path / "palette.png": ("1", "2"),
        saved(tmp_path / "colours.png", colours): ("140,25,255", "20,60,10"),
    }
    for path, (first, second) in paths.items():
        message = (
            rf"{path.name}: holds several labels, expected one of {second} \(264 px\), {first} "
        )
        assert_refused(message, read_mask, path)
        for label, mask in ((first, ONE), (second, OTHER)):
            np.testing.assert_array_equal(read_mask(path, MaskChoice(label)), mask)
    assert_refused("has no label 7, expected one of 2", read_mask, path.with_name("grey.png"),
                   MaskChoice("7"))  # fmt: skip
    assert_refused("expected a colour R,G,B", read_mask, path, MaskChoice("7"))


@pytest.mark.parametrize("value", [1, 2, 38, 100, 200])
def test_one_label_is_taken_whatever_its_value(tmp_path, value):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        mask = read_mask(saved(tmp_path / "one.png", (ONE * value).astype(np.uint8)))
    np.testing.assert_array_equal(mask > 0.5, ONE)


def test_the_soft_edge_of_a_mask_is_no_label():
    soft = np.asarray(Image.fromarray((ONE * 255).astype(np.uint8)).resize((75, 50)))
    assert len(np.unique(soft)) > 3
    assert labels_of(soft) == {255: labels_of(soft)[255]}
    assert labels_of(LABELS) == {1: 240, 2: 264}
    # The background is what most of the border shows.
    assert set(labels_of(LABELS + 5)) == {6, 7}


def test_a_jpeg_of_a_mask_has_no_labels(tmp_path):
    path = saved(tmp_path / "mask.jpg", (ONE * 255).astype(np.uint8), quality=60)
    np.testing.assert_array_equal(read_mask(path) > 0.5, ONE)


def test_arrays_of_segmenters_are_read(tmp_path):
    import torch

    for name, array in {
        "hw": ONE, "1hw": ONE[None], "11hw": ONE[None, None], "hw1": ONE[..., None],
        "1hw1": ONE[None, ..., None],
        "same": np.stack([ONE, ONE, ONE]), "float": ONE.astype("f4"), "white": ONE * 255.0,
    }.items():  # fmt: skip
        np.save(tmp_path / f"{name}.npy", array)
        np.testing.assert_array_equal(read_mask(tmp_path / f"{name}.npy"), ONE)
    np.savez(tmp_path / "a.npz", ONE)
    torch.save(torch.from_numpy(ONE[None]), tmp_path / "a.pt")
    for name in ("a.npz", "a.pt"):
        np.testing.assert_array_equal(read_mask(tmp_path / name), ONE)


def test_of_several_masks_in_an_array_one_must_be_chosen(tmp_path):
    np.save(tmp_path / "three.npy", np.stack([ONE, OTHER, ~ONE]))
    path = tmp_path / "three.npy"
    assert_refused(r"holds 3 masks, expected one of 0 \(240 px\), 1 \(264 px\)", read_mask, path)
    np.testing.assert_array_equal(read_mask(path, MaskChoice(index=1)), OTHER)
    assert_refused("has no mask 3, expected `mask_index` 0 to 2", read_mask, path,
                   MaskChoice(index=3))  # fmt: skip
    np.save(tmp_path / "one.npy", ONE)
    assert_refused("is one mask, `mask_index` 0", read_mask, tmp_path / "one.npy",
                   MaskChoice(index=0))  # fmt: skip


def test_a_batch_of_masks_is_an_array_of_masks(tmp_path):
    masks = np.stack([ONE, OTHER, ~ONE])
    for name, array in {
        "n1hw": masks[:, None],
        "1nhw": masks[None],
        "1n1hw": masks[None, :, None],
    }.items():
        path = tmp_path / f"{name}.npy"
        np.save(path, array)
        assert_refused(
            r"holds 3 masks, expected one of 0 \(240 px\), 1 \(264 px\)", read_mask, path
        )
        np.testing.assert_array_equal(read_mask(path, MaskChoice(index=1)), OTHER)
    for name, array in {"1hw": ONE[None], "11hw": ONE[None, None]}.items():
        np.save(tmp_path / f"{name}.npy", array)
        np.testing.assert_array_equal(read_mask(tmp_path / f"{name}.npy", MaskChoice(index=0)), ONE)
    assert_refused("has no mask 1, expected `mask_index` 0 to 0", read_mask,
                   tmp_path / "1hw.npy", MaskChoice(index=1))  # fmt: skip


def test_the_masks_of_sam_are_taken_by_name_and_listed_with_their_scores(tmp_path):
    path = tmp_path / "sam.npz"
    np.savez(
        path, masks=np.stack([ONE, OTHER, ~ONE]), scores=np.float32([0.5, 0.987, 0.1]),
        logits=np.zeros((3, 64, 64), "f4"), boxes=np.zeros((3, 4)),
    )  # fmt: skip
    assert_refused(
        r"expected one of 0 \(240 px, score 0\.5\), 1 \(264 px, score 0\.987\), 2", read_mask, path
    )
    np.testing.assert_array_equal(read_mask(path, MaskChoice(index=1)), OTHER)
    np.savez(path, alpha=ONE.astype("f4"), image=np.zeros((40, 60, 3), "u1"))
    np.testing.assert_array_equal(read_mask(path), ONE)
    np.savez(path, a=ONE, b=ONE)
    assert_refused("expected one mask .*, or one called masks or mask", read_mask, path)


def test_each_segmentation_of_several_pictures_has_the_size_of_its_own(tmp_path):
    square = [[2, 3, 8, 3, 8, 6, 2, 6]]
    document = {
        "images": [
            {"id": 7, "file_name": "a.jpg", "height": 40, "width": 60},
            {"id": 9, "file_name": "b.jpg", "height": 20, "width": 30},
        ],
        "annotations": [
            {"image_id": 9, "segmentation": square, "area": 18},
            {"image_id": 7, "segmentation": square, "area": 18},
            {"image_id": 5, "segmentation": square, "area": 18},
        ],
    }
    path = tmp_path / "set.json"
    path.write_text(json.dumps(document))
    assert_refused(r"expected one of 0 \(18 px, b\.jpg\), 1 \(18 px, a\.jpg\), 2 \(18 px\)",
                   read_mask, path)  # fmt: skip
    for index, shape in ((0, (20, 30)), (1, (40, 60))):
        mask = read_mask(path, MaskChoice(index=index))
        assert mask.shape == shape
        assert mask.sum() == 18
    assert_refused("does not say height and width of the picture", read_mask, path,
                   MaskChoice(index=2))  # fmt: skip


def test_logits_are_inside_where_they_are_over_zero(tmp_path):
    np.save(tmp_path / "logits.npy", np.where(ONE, 3.5, -7.25).astype("f4"))
    with pytest.warns(UserWarning, match=r"span -7.25 to 3.5, read as logits: inside is over 0"):
        np.testing.assert_array_equal(read_mask(tmp_path / "logits.npy"), ONE)


def test_coco_is_read_as_run_lengths_and_polygons(tmp_path):
    flat = ONE.T.ravel()
    edges = np.flatnonzero(np.diff(flat)) + 1
    counts = np.diff([0, *edges, flat.size]).tolist()
    rle = {"size": [40, 60], "counts": counts}
    polygon = {"segmentation": [[10, 8, 30, 8, 30, 20, 10, 20]], "height": 40, "width": 60}
    data_set = {
        "images": [{"height": 40, "width": 60}],
        "annotations": [{"segmentation": rle, "area": 240}, {"segmentation": rle, "area": 1}],
    }
    for name, document in (("rle", rle), ("annotation", {"segmentation": rle}), ("list", [rle])):
        (tmp_path / f"{name}.json").write_text(json.dumps(document))
        np.testing.assert_array_equal(read_mask(tmp_path / f"{name}.json"), ONE)
    (tmp_path / "polygon.json").write_text(json.dumps(polygon))
    drawn = read_mask(tmp_path / "polygon.json") > 0.5
    assert np.count_nonzero(drawn ^ ONE) <= np.count_nonzero(ONE) * 0.15
    (tmp_path / "set.json").write_text(json.dumps(data_set))
    assert_refused(r"holds 2 segmentations, expected one of 0 \(240 px\)", read_mask,
                   tmp_path / "set.json")  # fmt: skip
    np.testing.assert_array_equal(read_mask(tmp_path / "set.json", MaskChoice(index=0)), ONE)


def test_compressed_run_lengths_are_read():
    mask = read_mask(FILES / "rle.json")
    assert mask.shape == (256, 256)
    assert np.count_nonzero(mask) == 9679
    np.testing.assert_array_equal(read_mask(FILES / "sam_auto.json", MaskChoice(index=0)), mask)


def test_the_orientation_of_a_photo_is_known_and_its_raster_can_be_read_as_stored(tmp_path):
    exif = Image.Exif()
    exif[0x0112] = 6
    path = saved(tmp_path / "turned.png", (ONE * 255).astype(np.uint8), exif=exif)
    assert orientation(path) == 6
    assert read_mask(path).shape == (60, 40)
    np.testing.assert_array_equal(read_mask(path, upright=False), ONE)
    assert orientation(FILES / "camera.json") == 1


@pytest.mark.parametrize(
    "name", ["rle.json", "sam_auto.json", "palette.png", "labels16.png", "polygon.json"]
)
def test_damaged_masks_are_read_or_refused_in_one_line(tmp_path, name):
    path = tmp_path / name
    if name == "polygon.json":
        path.write_text(
            '{"segmentation": [[10, 8, 30, 8, 30, 20, 10, 20]], "height": 40, "width": 60}'
        )
    else:
        path.write_bytes((FILES / name).read_bytes())
    _, refused = assert_reads_or_refuses(lambda file: read_mask(file, MaskChoice()), path, 60)
    assert refused > 5


def test_a_folder_stands_for_its_masks_in_the_order_of_their_names(tmp_path):
    for name in ("b.png", "a.png"):
        saved(tmp_path / name, (ONE * 255).astype(np.uint8))
    (tmp_path / "notes.txt").write_text("no mask")
    assert [path.name for path in masks_in(tmp_path)] == ["a.png", "b.png"]
    numbered = tmp_path / "numbered"
    numbered.mkdir()
    for name in ("10.png", "2.png", "view_9.png", "view_10.png"):
        (numbered / name).touch()
    assert [path.stem for path in masks_in(numbered)] == ["2", "10", "view_9", "view_10"]
    assert masks_in(tmp_path / "a.png") == [tmp_path / "a.png"]
    (tmp_path / "empty").mkdir()
    assert_refused("holds no mask", masks_in, tmp_path / "empty")


@pytest.mark.parametrize("name", ["a.png", "a.jpg"])
@pytest.mark.parametrize("mode", ["L", "RGB"])
def test_a_photo_is_refused_whatever_its_background(tmp_path, name, mode):
    rng = np.random.default_rng(0)
    photo = np.full((240, 240), 255, np.uint8)
    rows, columns = np.mgrid[:240, :240]
    photo[np.hypot(rows - 120, columns - 120) < 100] = 190
    photo[np.hypot(rows - 120, columns - 120) < 40] = 60
    photo += (rows % 3).astype(np.uint8) * (photo < 250)
    for picture in (photo, rng.integers(60, 180, (80, 120)).astype(np.uint8)):
        if mode == "L" and picture is not photo and name.endswith("png"):
            continue  # a map of probabilities may be grey
        Image.fromarray(picture).convert(mode).save(tmp_path / name, quality=95)
        assert_refused(
            "is a photo, grey over large parts, expected a mask; segment the object first",
            read_mask,
            tmp_path / name,
        )


def test_labels_in_a_file_with_losses_are_refused(tmp_path):
    labels = np.zeros((60, 60), np.uint8)
    labels[5:25, 5:20], labels[30:50, 30:50] = 100, 200
    path = saved(tmp_path / "labels.jpg", labels, quality=90)
    assert_refused("is a JPEG file, whose losses change labels, expected a .png", read_mask, path,
                   MaskChoice("100"))  # fmt: skip
    assert_refused("grey over large parts", read_mask, path)


def test_run_lengths_that_do_not_fill_the_mask_are_refused(tmp_path):
    for counts in ("", "zzzz~~~~", "01"):
        (tmp_path / "bad.json").write_text(json.dumps({"size": [100, 120], "counts": counts}))
        assert_refused(
            "runs is .*, expected (12,000|whole numbers)", read_mask, tmp_path / "bad.json"
        )


def test_a_polygon_covers_its_area(tmp_path):
    square = {"segmentation": [[30, 20, 90, 20, 90, 60, 30, 60]], "height": 100, "width": 120}
    (tmp_path / "square.json").write_text(json.dumps(square))
    assert np.count_nonzero(read_mask(tmp_path / "square.json")) == 60 * 40


def test_a_label_on_a_bright_background_is_no_part_of_it(tmp_path):
    for background, colour in (((255, 255, 255), (200, 0, 0)), ((0, 0, 255), (255, 0, 0))):
        picture = np.full((40, 60, 3), background, np.uint8)
        picture[ONE] = colour
        np.testing.assert_array_equal(read_mask(saved(tmp_path / "c.png", picture)), ONE)


def test_the_background_of_a_palette_is_black_wherever_it_stands(tmp_path):
    image = Image.fromarray((~ONE).astype(np.uint8), "P")
    image.putpalette([200, 0, 0, 0, 0, 0])
    image.save(tmp_path / "p.png")
    np.testing.assert_array_equal(read_mask(tmp_path / "p.png"), ONE)


def test_a_mask_that_overshoots_is_no_array_of_logits(tmp_path):
    np.save(tmp_path / "under.npy", ONE * 1.04 - 0.02)
    np.testing.assert_array_equal(read_mask(tmp_path / "under.npy") > 0.5, ONE)


def test_labels_of_arrays_may_be_floats_and_not_booleans(tmp_path):
    np.save(tmp_path / "f.npy", LABELS.astype("f4"))
    np.testing.assert_array_equal(read_mask(tmp_path / "f.npy", MaskChoice("2")), OTHER)
    np.save(tmp_path / "b.npy", ONE)
    assert_refused("holds true and false", read_mask, tmp_path / "b.npy", MaskChoice("1"))


def test_a_label_of_a_list_without_labels_is_refused():
    path = FILES / "sam_auto.json"
    assert_refused("has no label 1, expected one of 0 .*: `mask_index` N", read_mask, path,
                   MaskChoice(label="1"))  # fmt: skip


def test_the_border_in_a_palette_of_labels_is_unknown(tmp_path):
    labels = np.where(OTHER, np.uint8(15), LABELS)
    labels[20:24], labels[:2] = 255, 255
    image = Image.fromarray(labels, "P")
    image.putpalette([c for i in range(256) for c in (i, 255 - i, 128)])
    image.putpalette([0, 0, 0, *image.getpalette()[3:]])
    image.save(tmp_path / "voc.png")
    assert_refused(r"one of 15 \(264 px\), 1 \(240 px\): `label` N", read_mask,
                   tmp_path / "voc.png")  # fmt: skip
    np.testing.assert_array_equal(read_mask(tmp_path / "voc.png", MaskChoice("15")), OTHER)
    (view,), _ = load_views(ViewFiles([tmp_path / "voc.png"], choice=MaskChoice("1")))
    np.testing.assert_array_equal(view.mask, ONE)
    np.testing.assert_array_equal(view.known, labels != 255)
    # Without another label 255 is the object.
    image.putdata((ONE * np.uint8(255)).ravel())
    image.save(tmp_path / "one.png")
    np.testing.assert_array_equal(read_mask(tmp_path / "one.png"), ONE)


@pytest.mark.parametrize(
    ("document", "says"),
    [
        ({"K": [], "R": []}, "is a camera file, expected a mask"),
        ({"boxes": []}, "size is missing, expected an annotation: COCO, SAM, labelme"),
    ],
)
def test_other_files_of_json_than_segmentations_are_named(tmp_path, document, says):
    (tmp_path / "a.json").write_text(json.dumps(document))
    assert_refused(says, read_mask, tmp_path / "a.json")


def test_an_array_of_no_mask_says_so(tmp_path):
    np.save(tmp_path / "a.npy", np.empty((0, 30, 40), bool))
    assert_refused(r"holds bool \[0, 30, 40\], expected a mask", read_mask, tmp_path / "a.npy")


def test_a_pixel_is_inside_if_its_middle_is_in_one_of_the_polygons(tmp_path):
    from skimage.draw import polygon2mask

    random = np.random.default_rng(0)
    polygons = [random.uniform(-20, 110, (corners, 2)) for corners in (3, 5, 9, 20)]
    polygon = {"segmentation": [p.ravel().tolist() for p in polygons], "height": 70, "width": 90}
    (tmp_path / "a.json").write_text(json.dumps(polygon))
    expected = np.any([polygon2mask((70, 90), p[:, ::-1] - 0.5) for p in polygons], axis=0)
    np.testing.assert_array_equal(read_mask(tmp_path / "a.json"), expected)
