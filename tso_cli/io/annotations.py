"""Objects that a labelling tool or a segmenter marks in a picture: JSON, XML or text -> a mask.

Read are COCO, SAM, labelme, CVAT, VIA, Label Studio, YOLO and Cityscapes. Each format gives its
objects as `Region`; one rule says which is meant, and one function fills outlines.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path, PureWindowsPath
from typing import Any, NamedTuple

import numpy as np

from ..errors import InputError
from ..geometry.arrays import Bits, Floats
from ..geometry.raster import fill
from .checked import Checked, kind
from .guard import reading
from .images import check_size, decoded, size_of_picture
from .reading import json_reason, plain

SUFFIXES = (".json", ".xml", ".txt")
NEEDS = (
    "an annotation: COCO, SAM, labelme, CVAT, VIA, Label Studio, YOLO or Cityscapes, with outlines "
    "or run lengths"
)
MOST_LISTED = 9
_PICTURES = (".jpg", ".jpeg", ".png", ".bmp", ".tif", ".tiff", ".webp")
# Pixels and crossings of rows that all parts of a mask may take; some 20 s.
MOST_WORK = 500_000_000


class Region(NamedTuple):
    """An object of a picture, or a part of it.

    draw : sets its pixels in a mask [H, W] of the picture. place : where the file has it.
    label : what it is called, or "". picture : the file, or "". size : width and height of the
    picture, None if the file does not say them. group : what all parts of one object share.
    notes : what a list says of it.
    """

    draw: Callable[[Bits], None]
    place: str
    label: str
    picture: str
    size: tuple[Any, Any]
    group: Any
    notes: str = ""


def read_annotation(
    data: bytes, path: Path, label: str | None, index: int | None, size: tuple[int, int] | None
) -> Floats:
    """The mask [H, W] of all that has the ``label``, or of the object number ``index``.

    ``size`` is the width and height of the picture, if neither the file says it nor the picture
    lies next to it. Raises InputError, which lists the objects, unless it is clear what is meant.
    """
    source = _Annotation(path)
    with reading(source, NEEDS):
        return source.mask(list(source.regions(data)), label, index, size)


class _Annotation(Checked):
    """An annotation file: its objects, and the mask of those that are meant."""

    def __init__(self, path: Path) -> None:
        self.path, self.work = path, 0

    def regions(self, data: bytes) -> Iterator[Region]:
        suffix, text = self.path.suffix.lower(), data.decode("utf-8-sig")
        if suffix == ".txt":
            return self._yolo(text)
        if suffix == ".xml":
            from .cameras.markup import root_of

            return self._cvat(root_of(text, self.path))
        try:
            document = json.loads(text)
        except (ValueError, RecursionError) as error:
            why = json_reason(error)
            raise InputError(f"{self.path}: is not JSON ({why}), expected a mask") from None
        listed = document if isinstance(document, list) else [document]
        first: dict[str, Any] = listed[0] if listed and isinstance(listed[0], dict) else {}
        if first.keys() & {"K", "views", "frames"}:
            raise InputError(f"{self.path}: is a camera file, expected a mask or {NEEDS}")
        if first.keys() & {"shapes", "objects"}:
            return self._shapes(document)
        if "_via_img_metadata" in first:
            return self._via(first["_via_img_metadata"])
        if first and all(isinstance(v, dict) and "regions" in v for v in first.values()):
            return self._via(first)
        annotations = first.get("annotations", first.get("masks", listed))
        tasks = [task for task in listed if isinstance(task, dict)]
        if any("result" in entry for task in tasks for entry in task.get("annotations", [])):
            return self._label_studio(listed)
        names = {entry["id"]: entry["name"] for entry in first.get("categories", [])}
        return self._coco(annotations, first.get("images", []), names)

    def mask(
        self, regions: list[Region], label: str | None, index: int | None, size: Any
    ) -> Floats:
        groups = {
            region.group
            for number, region in enumerate(regions)
            if label in (None, region.label) and index in (None, number)
        }
        meant = [region for region in regions if region.group in groups]
        pictures = {region.picture for region in meant}
        if len(pictures) != 1 or (len(groups) > 1 and label is None):
            raise self._which(regions, label, index)
        width, height = self._size(meant[0], size)
        mask = np.zeros((height, width), bool)
        for region in meant:
            self.place = region.place
            region.draw(mask)
        return mask.astype(np.float32)

    def _which(self, regions: list[Region], label: str | None, index: int | None) -> InputError:
        if not regions:
            return InputError(f"{self.path}: holds no outline of an object, expected {NEEDS}")
        several, listed = len({region.picture for region in regions}) > 1, []
        for number, (_, _, name, picture, _, _, notes) in enumerate(regions[:MOST_LISTED]):
            words = ", ".join(filter(None, (name, notes, picture if several else "")))
            listed.append(plain(f"{number} ({words})" if words else f"{number}"))
        listed += ["..."] if len(regions) > MOST_LISTED else []
        wrong = f"holds {len(regions)} segmentations"
        if index is not None:
            wrong = f"has no mask {index}" + (f" of label {plain(label)}" if label else "")
        elif label is not None and label not in [region.label for region in regions]:
            wrong = f"has no label {plain(label)}"
        by_label = "`label` NAME or " if any(region.label for region in regions) else ""
        what = f"expected one of {', '.join(listed)}: {by_label}`mask_index` N"
        return InputError(f"{self.path}: {wrong}, {what}")

    def _size(self, region: Region, size: tuple[int, int] | None) -> tuple[int, int]:
        """Width and height of the picture: by the file, by the picture next to it, or ``size``."""
        sides: tuple[Any, Any] | None = region.size
        if None in region.size:
            name = PureWindowsPath(region.picture).name
            names = [name] if name else [f"{self.path.stem}{suffix}" for suffix in _PICTURES]
            images = ("images" if p == "labels" else p for p in self.path.parent.parts)
            folders = (self.path.parent, Path(*images))
            sizes = (size_of_picture(folder / file) for folder in folders for file in names)
            sides = next(filter(None, sizes), size)
            if sides is None:
                raise InputError(
                    f"{self.path}: does not say height and width of the picture, expected "
                    f"{plain(names[0])} next to it, or a camera file with width and height"
                )
        width, height = self.pixels("", *sides)  # type: ignore[misc]
        check_size(width, height, self.path)
        return width, height

    def _each(self, name: str, entries: Iterable[Any]) -> Iterator[Any]:
        place = self.place
        for number, entry in enumerate(entries):
            self.place = f"{place}{name}[{number}]."
            yield entry
        self.place = place

    def _region(
        self,
        draw: Callable[[Bits], None],
        label: Any,
        picture: Any = None,
        size: tuple[Any, Any] = (None, None),
        group: Any = None,
        notes: str = "",
    ) -> Region:
        group = self.place if group is None else (label, picture, group)
        return Region(draw, self.place, str(label), str(picture or ""), size, group, notes)

    def _coco(
        self, entries: list[Any], pictures: list[Any], names: dict[Any, str]
    ) -> Iterator[Region]:
        """Also masks of SAM. A picture is the only one, the one of ``image_id``, or the entry."""
        of_id = {picture.get("id"): picture for picture in pictures}
        for entry in self._each("annotations", entries):
            picture = pictures[0] if len(pictures) == 1 else of_id.get(entry.get("image_id"), entry)
            size = picture.get("width"), picture.get("height")
            shape = entry.get("segmentation", None if "bbox" in entry else entry)
            if shape is None:  # a box alone
                continue
            draw = partial(self._polygons, shape)
            if not isinstance(shape, list):
                (rows, columns), draw = shape["size"], partial(self._columns, shape["counts"])
                if size not in ((None, None), (columns, rows)):
                    wrong = f"{kind(rows)} x {kind(columns)}"
                    raise self.error("size", wrong, f"that of its picture, {size[1]} x {size[0]}")
                size = columns, rows
            score = entry.get("score", entry.get("predicted_iou"))
            notes = [f"{entry['area']} px"] if "area" in entry else []
            notes += [f"score {score:.3g}"] if isinstance(score, float) else []
            name = picture.get("file_name", picture.get("id")) if pictures else None
            label = names.get(entry.get("category_id"), "")
            if shape:
                yield self._region(draw, label, name, size, notes=", ".join(notes))

    def _shapes(self, document: dict[str, Any]) -> Iterator[Region]:
        """Of labelme, and of Cityscapes, whose later objects lie in front of the others."""
        get = document.get
        size = get("imageWidth", get("imgWidth")), get("imageHeight", get("imgHeight"))
        objects = [shape for shape in get("objects", []) if not shape.get("deleted")]
        for number, shape in enumerate(self._each("objects", objects), 1):
            in_front = [other["polygon"] for other in objects[number:]]
            draw = partial(self._behind, shape["polygon"], in_front)
            yield self._region(draw, shape["label"], None, size)
        for shape in self._each("shapes", get("shapes", [])):
            points, form = shape["points"], shape.get("shape_type")
            if form not in (None, "polygon", "mask"):
                continue
            draw = partial(self._outline, points)
            if form == "mask":
                draw = partial(self._bitmap, shape["mask"], points[0])
            group = shape.get("group_id")
            yield self._region(draw, shape["label"], get("imagePath"), size, group)

    def _via(self, pictures: dict[str, Any]) -> Iterator[Region]:
        for picture in self._each("pictures", pictures.values()):
            regions = picture["regions"]
            regions = regions.values() if isinstance(regions, dict) else regions
            for region in self._each("regions", regions):
                shape, attributes = region["shape_attributes"], region.get("region_attributes", {})
                if "all_points_x" in shape and shape.get("name") != "polyline":
                    points = list(zip(shape["all_points_x"], shape["all_points_y"], strict=True))
                    label = next(iter(attributes.values()), "")
                    label = next(iter(label), "") if isinstance(label, dict) else label
                    yield self._region(partial(self._outline, points), label, picture["filename"])

    def _label_studio(self, tasks: list[Any]) -> Iterator[Region]:
        for task in self._each("tasks", tasks):
            picture = next(iter(task.get("data", {}).values()), None)
            entries = [entry for entry in task["annotations"] if not entry.get("was_cancelled")]
            results = [result for entry in entries for result in entry["result"]]
            for result in self._each("result", results):
                value = result.get("value", {})
                if not value.keys() & {"points", "rle"}:
                    continue
                draw = partial(self._outline, value.get("points"), whole=100.0)
                if "rle" in value:
                    draw = partial(self._brush, value["rle"])
                labels = [name for key in value if key.endswith("labels") for name in value[key]]
                size = result["original_width"], result["original_height"]
                yield self._region(draw, (labels or [""])[0], picture, size)

    def _yolo(self, text: str) -> Iterator[Region]:
        for line in self._each("lines", text.splitlines()):
            label, *words = line.split() or [""]
            # Four numbers are a box. A last one is how sure a network is.
            if len(words) > 5:
                points = [float(word) for word in words[: len(words) // 2 * 2]]
                yield self._region(partial(self._outline, points, whole=1.0), label)

    def _cvat(self, root: Any) -> Iterator[Region]:
        for image in self._each("image", root.iter("image")):
            size = int(image.attrib["width"]), int(image.attrib["height"])
            for shape in self._each("shape", image):
                if shape.tag == "mask":
                    draw = partial(self._rows, dict(shape.attrib))
                elif shape.tag == "polygon":
                    pairs = (pair.split(",") for pair in shape.attrib["points"].split(";"))
                    draw = partial(self._outline, [[float(x), float(y)] for x, y in pairs])
                else:
                    continue
                of_shape = shape.get("label", ""), image.get("name"), size, shape.get("group_id")
                yield self._region(draw, *of_shape)

    def _outline(self, points: Any, mask: Bits, whole: float | None = None) -> None:
        """A polygon, in px from the corner of the picture, or in shares of ``whole``."""
        corners = self.matrix("points", points, (-1, 2), (-1,)).reshape(-1, 2)
        if len(corners) < 3:
            raise self.error("points", kind(points), "x and y of three corners or more")
        if whole is not None:
            if np.abs(corners).max() > 2.0 * whole:
                raise self.error("points", f"up to {corners.max():g}", f"shares of {whole:g}")
            corners = corners / whole * mask.shape[::-1]
        self.work += fill(mask, corners - 0.5, MOST_WORK - self.work)

    def _behind(self, points: Any, in_front: list[Any], mask: Bits) -> None:
        visible, hidden = np.zeros_like(mask), np.zeros_like(mask)
        self._outline(points, visible)
        for other in in_front:
            self._outline(other, hidden)
        mask |= visible & ~hidden

    def _polygons(self, polygons: list[Any], mask: Bits) -> None:
        for polygon in polygons:
            self._outline(polygon, mask)

    def _bitmap(self, picture: str, corner: Any, mask: Bits) -> None:
        data = base64.b64decode(picture)
        bits = decoded(data, self.path, "a mask", lambda image, _: np.asarray(image.convert("L")))
        self._spend(bits.size)
        left, top = map(round, corner)
        _place(bits != 0, left, top, mask)

    def _rows(self, attributes: dict[str, str], mask: Bits) -> None:
        """Runs along the rows of a box."""
        left, top, w, h = (int(attributes[key]) for key in ("left", "top", "width", "height"))
        check_size(w, h, self.path)
        runs = [int(run) for run in attributes["rle"].split(",")]
        _place(self._runs(runs, h * w).reshape(h, w), left, top, mask)

    def _columns(self, counts: Any, mask: Bits) -> None:
        runs = _decoded(counts) if isinstance(counts, str) else counts
        mask |= self._runs(runs, mask.size).reshape(mask.shape[::-1]).T

    def _spend(self, work: int) -> None:
        """Count ``work``; ValueError if it is too much."""
        self.work += work
        if self.work > MOST_WORK:
            raise ValueError(f"parts of over {MOST_WORK:,} pixels in all")

    def _runs(self, runs: list[int], size: int) -> Bits:
        """Pixels [size] of runs of background and foreground in turn."""
        if not all(type(run) is int and run >= 0 for run in runs):
            raise self.error("runs", kind(runs), "whole numbers, 0 or more")
        if (total := sum(runs)) != size:
            raise self.error("total of runs", f"{total:,}", f"{size:,} by its size")
        self._spend(size)
        return np.repeat(np.arange(len(runs)) % 2 == 1, runs)

    def _brush(self, data: list[int], mask: Bits) -> None:
        """A brush of Label Studio: four channels, packed by thi.ng/rle-pack; the last is alpha."""
        bits, at = "".join(f"{byte:08b}" for byte in bytes(list(data))), 0

        def number(length: int) -> int:
            nonlocal at
            at += length
            return int(bits[at - length : at], 2)

        if (total := number(32)) != 4 * mask.size:
            raise self.error("total of its brush", f"{total:,}", f"{4 * mask.size:,}")
        word, lengths = number(5) + 1, [number(4) + 1 for _ in range(4)]
        values, i = np.zeros(total, np.uint8), 0
        while i < total:
            same, end = number(1), i + 1 + number(lengths[number(2)])
            values[i:end] = number(word) if same else [number(word) for _ in range(i, end)]
            i = end
        mask |= values.reshape(*mask.shape, 4)[..., 3] > 0


def _place(bits: Bits, left: int, top: int, mask: Bits) -> None:
    """Set ``bits`` [h, w] in a mask; ValueError if they do not lie inside it."""
    if min(left, top) < 0:
        raise ValueError("a part outside of the picture")
    mask[top : top + bits.shape[0], left : left + bits.shape[1]] |= bits


def _decoded(text: str) -> list[int]:
    """The run lengths of a compressed ``text``.

    A number has five bits in each character, least first, and is signed; from the third number on
    it is the difference to the number before the last one.
    """
    runs: list[int] = []
    value = shift = 0
    for letter in text.encode("ascii"):
        bits = letter - 48
        value |= (bits & 31) << shift
        shift += 5
        if not bits & 32:
            value -= (bits & 16) << (shift - 4)
            runs.append(value + (runs[-2] if len(runs) > 2 else 0))
            value = shift = 0
        elif shift > 60:
            raise ValueError("a run length of over 60 bits")
    return runs
