"""Segmentations of COCO: run lengths or polygons, alone, in an annotation, or in a list."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError
from ..geometry.arrays import Bits, Floats
from .checked import Checked, kind
from .guard import reading
from .images import check_size
from .reading import json_reason, plain

# Keys of other files of JSON, and what these are.
_NO_MASKS = (
    ({"K"}, "a camera file"), ({"views"}, "a camera file"), ({"frames"}, "a camera file"),
    ({"shapes", "imagePath"}, "an annotation of LabelMe; export it as COCO (labelme2coco)"),
    ({"_via_img_metadata"}, "a project of VIA; export its annotations as COCO"),
    ({"filename", "regions"}, "an annotation of VIA; export it as COCO"),
)  # fmt: skip
NEEDS = "a segmentation of COCO: size and counts, or polygons with height and width of the picture"
MOST_LISTED = 9


class _Segmentations(Checked):
    """The segmentations in the JSON file ``path``, and the pictures that they are of."""

    def __init__(self, document: Any, path: Path) -> None:
        self.path = path
        first = document[0] if isinstance(document, list) and document else document
        for keys, what in _NO_MASKS:
            if isinstance(first, dict) and first.keys() >= keys:
                raise InputError(
                    f"{path}: is {what}, expected a mask: a picture, or a segmentation of COCO"
                )
        self._pictures: list[dict[str, Any]] = []
        if isinstance(document, dict) and "annotations" in document:
            self._pictures, document = document.get("images", []), document["annotations"]
        self._entries: list[dict[str, Any]] = document if isinstance(document, list) else [document]
        if not self._entries or not all(isinstance(entry, dict) for entry in self._entries):
            raise InputError(f"{path}: holds {kind(document)}, expected {NEEDS}")

    def numbered(self, index: int | None) -> Floats:
        """The mask number ``index``; None if there is one alone."""
        entries = self._entries
        if index is None and len(entries) > 1:
            lines = [self._line(i, entry) for i, entry in enumerate(entries[:MOST_LISTED])]
            more = ", ..." if len(entries) > MOST_LISTED else ""
            raise InputError(
                f"{self.path}: holds {len(entries)} segmentations, expected one of "
                f"{', '.join(lines)}{more}: `mask_index` N"
            )
        number = index or 0
        if not 0 <= number < len(entries):
            raise InputError(
                f"{self.path}: has no mask {number}, expected `mask_index` 0 to {len(entries) - 1}"
            )
        segmentation = entries[number].get("segmentation", entries[number])
        if isinstance(segmentation, list):
            return self._of_polygons(segmentation, self._picture_of(entries[number]))
        return self._of_run_lengths(segmentation, self._picture_of(entries[number]))

    def _line(self, index: int, entry: dict[str, Any]) -> str:
        picture = self._picture_of(entry) if len(self._pictures) > 1 else entry
        name = "" if picture is entry else f", {picture.get('file_name', picture.get('id'))}"
        return plain(f"{index} ({entry.get('area', '?')} px{name})")

    def _picture_of(self, entry: dict[str, Any]) -> dict[str, Any]:
        """The picture of an annotation: the only one, the one of its ``image_id``, or itself."""
        if len(self._pictures) == 1:
            return self._pictures[0]
        number = entry.get("image_id")
        of_number = (p for p in self._pictures if number is not None and p.get("id") == number)
        return next(of_number, entry)

    def _size(self, height: Any, width: Any) -> tuple[int, int]:
        if not (type(height) is int and type(width) is int and min(height, width) > 0):
            sides = f"{kind(height)} x {kind(width)}"
            raise self.error("the size", sides, "height and width of the picture")
        check_size(width, height, self.path)
        return height, width

    def _of_polygons(self, polygons: list[Any], picture: dict[str, Any]) -> Floats:
        from skimage.draw import polygon2mask

        size = self._size(picture.get("height"), picture.get("width"))
        inside = np.zeros(size, bool)
        for number, polygon in enumerate(polygons):
            corners = self.matrix(f"polygon {number}", polygon, (-1,)).reshape(-1, 2)
            if len(corners) < 3 or np.abs(corners).max() > 1e6:
                raise self.error(f"polygon {number}", kind(polygon), "numbers x, y, x, y, ...")
            # COCO counts from the corner of a pixel.
            inside |= polygon2mask(size, corners[:, ::-1] - 0.5)
        return inside.astype(np.float32)

    def _of_run_lengths(self, segmentation: dict[str, Any], picture: dict[str, Any]) -> Floats:
        """Runs of background and foreground in turn, down the columns."""
        (rows, columns), counts = segmentation["size"], segmentation["counts"]
        height, width = self._size(rows, columns)
        of_picture = [picture.get("height", height), picture.get("width", width)]
        if of_picture != [height, width]:
            raise self.error("size", f"{height} x {width}", f"that of its picture, {of_picture}")
        runs = _decoded(counts) if isinstance(counts, str) else counts
        if not all(type(run) is int and run >= 0 for run in runs):
            raise self.error("runs", kind(counts), "whole numbers, 0 or more")
        if (total := sum(runs)) != height * width:
            raise self.error("total of runs", f"{total:,}", f"{height * width:,} by its size")
        inside: Bits = np.arange(len(runs)) % 2 == 1
        return np.repeat(inside, runs).reshape(width, height).T.astype(np.float32)


def read_coco(data: bytes, path: Path, index: int | None) -> Floats:
    """The mask [H, W] number ``index`` of the JSON in ``data``; None if there is one alone."""
    try:
        document = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: is not JSON ({json_reason(error)}), expected a mask") from None
    segmentations = _Segmentations(document, path)
    segmentations.place = "its segmentation "
    with reading(segmentations, NEEDS):
        return segmentations.numbered(index)


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
