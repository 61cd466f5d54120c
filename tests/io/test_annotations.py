"""Masks in the files of labelling tools and segmenters."""

import base64
import io
import json
import time

import numpy as np
import pytest
from PIL import Image
from scipy.ndimage import binary_fill_holes

from tests.corruption import assert_reads_or_refuses, assert_refused
from tso_cli.io.masks import MaskChoice, read_mask
from tso_cli.io.views import ViewFiles, load_views

from .test_masks import FILES, ONE, OTHER

NAMES = (
    "labelme.json", "cvat.xml", "via.json", "labelstudio.json", "yolo.txt", "cityscapes.json",
    "sam3.json",
)  # fmt: skip
SIZE = {"imageWidth": 60, "imageHeight": 40, "imagePath": "a.jpg"}
CORNERS = [[10, 8], [30, 8], [30, 20], [10, 20]]
OF_OTHER = [[34, 24], [56, 24], [56, 36], [34, 36]]


@pytest.fixture
def saved(tmp_path):
    def save(name, document):
        text = document if isinstance(document, str) else json.dumps(document)
        (tmp_path / name).write_text(text)
        return tmp_path / name

    return save


@pytest.mark.parametrize("name", NAMES)
def test_an_outline_is_the_object_whatever_tool_drew_it(name):
    truth = read_mask(FILES / "rle.json") > 0.5
    mask = read_mask(FILES / name, MaskChoice(index=0), size=(256, 256)) > 0.5
    # An outline shows no holes.
    closed = truth if name == "sam3.json" else binary_fill_holes(truth)
    assert (mask & closed).sum() > 0.97 * (mask | closed).sum()


@pytest.mark.parametrize("name", NAMES)
def test_damaged_annotations_are_read_or_refused_in_one_line(tmp_path, name):
    path = tmp_path / name
    path.write_bytes((FILES / name).read_bytes())
    choice = MaskChoice(index=0)
    _, refused = assert_reads_or_refuses(lambda file: read_mask(file, choice), path, 60)
    assert refused > 5


def shape(label, points, group=None, **more):
    return {"label": label, "points": points, "group_id": group, "shape_type": "polygon"} | more


def test_a_label_means_all_that_have_it_and_an_index_one(saved):
    shapes = [shape("cup", CORNERS), shape("lid", OF_OTHER), shape("cup", [[0, 0], [4, 0], [4, 4]])]
    path = saved("a.json", SIZE | {"shapes": shapes})
    listed = r"expected one of 0 \(cup\), 1 \(lid\), 2 \(cup\): `label` NAME or `mask_index` N"
    assert_refused(f"holds 3 segmentations, {listed}", read_mask, path)
    assert_refused(f"has no label pan, {listed}", read_mask, path, MaskChoice("pan"))
    assert_refused(f"has no mask 1 of label cup, {listed}", read_mask, path, MaskChoice("cup", 1))
    for choice in (MaskChoice("lid"), MaskChoice(index=1)):
        np.testing.assert_array_equal(read_mask(path, choice), OTHER)
    cups = read_mask(path, MaskChoice("cup")) > 0.5
    assert cups[ONE].all()
    assert cups.sum() == ONE.sum() + read_mask(path, MaskChoice(index=2)).sum()


def test_parts_of_one_group_are_one_object(saved):
    path = saved("a.json", SIZE | {"shapes": [shape("cup", CORNERS, 3), shape("cup", OF_OTHER, 3)]})
    np.testing.assert_array_equal(read_mask(path), ONE | OTHER)


def test_the_categories_of_coco_are_labels(saved):
    segmentations = [[np.ravel(corners).tolist()] for corners in (CORNERS, OF_OTHER)]
    document = {
        "images": [{"id": 1, "width": 60, "height": 40, "file_name": "a.jpg"}],
        "categories": [{"id": 1, "name": "cup"}, {"id": 2, "name": "lid"}],
        "annotations": [
            {"image_id": 1, "category_id": 1 + i, "segmentation": segmentation}
            for i, segmentation in enumerate(segmentations)
        ],
    }
    np.testing.assert_array_equal(read_mask(saved("a.json", document), MaskChoice("lid")), OTHER)
    document["images"].append({"id": 2, "width": 60, "height": 40, "file_name": "b.jpg"})
    document["annotations"][1] |= {"image_id": 2, "category_id": 1}
    assert_refused(
        r"holds 2 segmentations, expected one of 0 \(cup, a.jpg\), 1 \(cup, b.jpg\)",
        read_mask, saved("a.json", document), MaskChoice("cup"),
    )  # fmt: skip


def test_a_bitmap_of_labelme_lies_in_its_box(saved):
    stream = io.BytesIO()
    Image.fromarray(ONE[8:20, 10:30].astype(np.uint8)).save(stream, "PNG")
    drawn = base64.b64encode(stream.getvalue()).decode()
    box = shape("cup", [[10, 8], [29, 19]], shape_type="mask", mask=drawn)
    np.testing.assert_array_equal(read_mask(saved("a.json", SIZE | {"shapes": [box]})), ONE)
    outside = box | {"points": [[50, 8], [69, 19]]}
    assert_refused("cannot be read", read_mask, saved("b.json", SIZE | {"shapes": [outside]}))


def test_a_mask_of_cvat_is_run_lengths_along_the_rows_of_its_box(saved):
    text = """<annotations><image name="a.jpg" width="60" height="40">
    <mask label="cup" rle="0, 240" left="10" top="8" width="20" height="12"/>
    </image></annotations>"""
    np.testing.assert_array_equal(read_mask(saved("a.xml", text)), ONE)
    endless = text.replace('width="20"', 'width="99999999"').replace("240", "9" * 12)
    assert_refused("expected at most 100,000,000", read_mask, saved("b.xml", endless))


def packed(values):
    """``values`` as the brush of Label Studio packs them."""
    bits = f"{len(values):032b}{7:05b}" + "".join(f"{n - 1:04b}" for n in (3, 4, 8, 16))
    edges = [0, *np.flatnonzero(np.diff(values)) + 1, len(values)]
    for begin, end in zip(edges, edges[1:], strict=False):
        kind = "000000" if end - begin == 1 else f"111{end - begin - 1:016b}"
        bits += f"{kind}{values[begin]:08b}"
    return [int(bits[i : i + 8].ljust(8, "0"), 2) for i in range(0, len(bits), 8)]


def test_a_brush_of_label_studio_is_read(saved):
    dotted = ONE.copy()
    dotted[30, 3] = True
    colours = np.zeros((40, 60, 4), np.uint8)
    colours[dotted] = 200, 10, 90, 255
    value = {"format": "rle", "rle": packed(colours.ravel()), "brushlabels": ["cup"]}
    result = {"original_width": 60, "original_height": 40, "type": "brushlabels", "value": value}
    tasks = [{"data": {"image": "a.jpg"}, "annotations": [{"result": [result]}]}]
    np.testing.assert_array_equal(read_mask(saved("a.json", tasks)), dotted)
    np.testing.assert_array_equal(read_mask(saved("a.json", tasks), MaskChoice("cup")), dotted)
    result["original_width"] = 61
    assert_refused("total of its brush is 9,600, expected 9,760", read_mask,
                   saved("a.json", tasks))  # fmt: skip


def test_a_size_that_no_file_says_is_that_of_the_picture_or_of_the_camera(tmp_path):
    labels, images = tmp_path / "labels", tmp_path / "images"
    labels.mkdir()
    images.mkdir()
    path = labels / "a.txt"
    path.write_text("3 " + " ".join(f"{x / 60} {y / 40}" for x, y in CORNERS))
    assert_refused("does not say height and width of the picture, expected a.jpg next to it, or a "
                   "camera file", read_mask, path)  # fmt: skip
    camera = tmp_path / "camera.json"
    camera.write_text(json.dumps({"width": 60, "height": 40, "K": [[60, 0, 30], [0, 60, 20],
                      [0, 0, 1]], "R": np.eye(3).tolist(), "t": [0, 0, 2]}))  # fmt: skip
    (view,), _ = load_views(ViewFiles([path], camera))
    np.testing.assert_array_equal(view.mask, ONE)
    exif = Image.Exif()
    exif[0x0112] = 6
    Image.new("L", (40, 60)).save(images / "a.jpg", exif=exif)
    np.testing.assert_array_equal(read_mask(path, MaskChoice("3")), ONE)
    path.write_text("3 10 8 30 8 30 20")
    assert_refused("points is up to 30, expected shares of 1", read_mask, path)


def test_a_small_file_takes_no_gigabytes_and_no_minutes(saved):
    begun = time.process_time()
    zigzag = [[5.0 * (i % 2), 30_000.0 * (i % 2)] for i in range(4_000)]
    document = {"imageWidth": 10, "imageHeight": 30_000, "shapes": [shape("cup", zigzag)]}
    assert_refused("outlines that cross", read_mask, saved("a.json", document))
    document["imageWidth"] = 10_000
    assert_refused("expected at most 100,000,000", read_mask, saved("b.json", document))
    assert_refused("cannot be read|another form", read_mask, saved("c.json", {
        "size": [4, 4], "counts": 10**12}))  # fmt: skip
    whole = [[0, 0, 9_000, 0, 9_000, 9_000, 0, 9_000]] * 2_000
    picture = {"width": 9_000, "height": 9_000, "segmentation": whole}
    assert_refused("outlines that cross", read_mask, saved("d.json", picture))
    assert time.process_time() - begun < 20.0


def test_a_file_without_an_outline_is_refused(saved):
    for name, document in {
        "a.json": {"images": [], "annotations": []},
        "b.json": SIZE | {"shapes": [shape("cup", [[1, 1], [9, 9]], shape_type="line")]},
        "c.txt": "0 0.5 0.5 0.2 0.2\n",
        "d.xml": "<annotation><object/></annotation>",
    }.items():
        assert_refused("holds no outline of an object, expected an annotation: COCO, SAM",
                       read_mask, saved(name, document))  # fmt: skip


def test_later_objects_of_cityscapes_lie_in_front_and_deleted_ones_are_not_there(tmp_path):
    square = [[2, 2], [10, 2], [10, 10], [2, 10]]
    front = [[6, 2], [10, 2], [10, 10], [6, 10]]
    objects = [
        {"label": "car", "polygon": square},
        {"label": "person", "polygon": front},
        {"label": "car", "polygon": [[0, 0], [1, 0], [1, 1]], "deleted": 1},
    ]
    path = tmp_path / "a.json"
    path.write_text(json.dumps({"imgHeight": 12, "imgWidth": 12, "objects": objects}))
    assert read_mask(path, MaskChoice("car")).sum() == 4 * 8
    assert read_mask(path, MaskChoice("person")).sum() == 4 * 8


def test_boxes_lines_and_cancelled_work_are_no_objects(tmp_path):
    outline = [1.0, 1.0, 9.0, 1.0, 9.0, 9.0, 1.0, 9.0]
    picture = {"images": [{"id": 1, "width": 12, "height": 12}]}
    entries = [{"image_id": 1, "bbox": [0, 0, 3, 3]}, {"image_id": 1, "segmentation": [outline]}]
    path = tmp_path / "a.json"
    path.write_text(json.dumps({**picture, "annotations": entries}))
    assert read_mask(path).sum() == 64
    sure = "0 " + " ".join(str(value / 12.0) for value in outline) + " 0.9\n"
    (tmp_path / "b.txt").write_text("0 0.5 0.5 0.2 0.2 0.9\n" + sure)
    Image.new("L", (12, 12)).save(tmp_path / "b.png")
    assert read_mask(tmp_path / "b.txt").sum() == 64


def test_the_parts_of_a_mask_may_take_so_much_work_in_all(tmp_path):
    runs = {"size": [10000, 10000], "counts": [99999999, 1]}
    entries = [{"image_id": 1, "category_id": 1, "segmentation": runs} for _ in range(20)]
    document = {"images": [{"id": 1, "width": 10000, "height": 10000}], "annotations": entries}
    path = tmp_path / "a.json"
    path.write_text(json.dumps({**document, "categories": [{"id": 1, "name": "a"}]}))
    assert_refused("parts of over 500,000,000 pixels in all", read_mask, path, MaskChoice("a"))
