"""Which objects are for training, validation and test. A split is one of the following.

- A JSON file: {"train": [NAME, ...], "validation": [...], "test": [...]}, with the names that the
  data set gives to its objects. A part may be missing.
- The folder of the CAPNet authors, with the files SYNSET_train_list.txt, SYNSET_val_list.txt and
  SYNSET_test_list.txt, one model per line, or .npy files with an array of texts. An object is named
  SYNSET/MODEL. The folder may be given itself, or the folder that has it as splits or
  ShapeNet_rendered/splits.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..io.output import reason
from ..io.reading import array_header, read_array, read_bytes, read_json, shown
from . import common
from .shapenet import RENDERED, SPLITS

PARTS = ("train", "validation", "test")
_FILE = re.compile(r"(?P<category>.+)_(?P<part>train|val|test)_list\.(?P<kind>txt|npy)")
_FILE_LIMIT = 1 << 28


def read_split(path: Path) -> dict[str, list[str]]:
    """The names of the objects of each part, without repetitions.

    Raises InputError if there are none, or if an object is in two parts.
    """
    split = _from_folder(path) if path.is_dir() else _from_json(path)
    split = {part: list(dict.fromkeys(split[part])) for part in PARTS if part in split}
    if not any(split.values()):
        raise InputError(f"{path}: names no object, expected some for {', '.join(PARTS)}")
    part_of: dict[str, str] = {}
    for part, names in split.items():
        for name in names:
            if name in part_of:
                raise InputError(
                    f"{path}: names {shown(name)} for {part_of[name]} and for {part}, "
                    "expected one of them"
                )
            part_of[name] = part
    return split


def read_part(path: Path, part: str) -> list[str]:
    """The names of the objects of one ``part``; InputError if the split has no such part."""
    split = read_split(path)
    if part not in split:
        raise InputError(
            f"{path}: has no list {part!r} (lists: {', '.join(map(repr, split))}), expected one"
        )
    return split[part]


def _from_json(path: Path) -> dict[str, list[str]]:
    form = '{"train": [...], "validation": [...], "test": [...]}'
    document = read_json(path, "a split (JSON, or a folder of lists)", form, _FILE_LIMIT)
    if not isinstance(document, dict) or not document:
        raise InputError(f"{path}: holds {shown(document)}, expected {form}")
    for part, names in document.items():
        if part not in PARTS:
            raise InputError(f"{path}: has the part {shown(part)}, expected {', '.join(PARTS)}")
        if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
            raise InputError(f"{path}: {part} is {shown(names)}, expected a list of names")
    return document


def _from_folder(folder: Path) -> dict[str, list[str]]:
    # The authors keep the lists inside the folder of the pictures.
    folder = next(
        (place for place in (folder / SPLITS, folder / RENDERED / SPLITS) if place.is_dir()), folder
    )
    matches = filter(None, map(_FILE.fullmatch, sorted(common.listed(folder)[1])))
    # If a list exists in both forms, the text file comes later and is taken.
    lists = {(match["category"], match["part"]): folder / match[0] for match in matches}
    if not lists:
        raise InputError(
            f"{folder}: holds no list, expected SYNSET_train_list.txt or .npy and so on"
        )
    split: dict[str, list[str]] = {}
    for (category, part), path in lists.items():
        names = _array(path) if path.suffix == ".npy" else _lines(path)
        models = split.setdefault("validation" if part == "val" else part, [])
        models.extend(name if "/" in name else f"{category}/{name}" for name in names)
    return split


def _lines(path: Path) -> list[str]:
    try:
        text = read_bytes(path, "a list of models, one per line", limit=_FILE_LIMIT).decode("utf-8")
    except UnicodeDecodeError as error:
        raise InputError(
            f"{path}: is not text ({reason(error)}), expected a list of models, one per line"
        ) from None
    return [line.strip() for line in text.splitlines() if line.strip()]


def _array(path: Path) -> list[str]:
    data = read_bytes(path, "an array of texts", limit=_FILE_LIMIT)
    dtype, shape, _, _ = array_header(data, path)
    if dtype.hasobject:
        raise InputError(
            f"{path}: holds pickled Python objects, which are not loaded because that could run "
            "anything; expected texts: numpy.save(path, array.astype(str)), or a .txt with a name "
            "per line"
        )
    if dtype.kind not in "US" or len(shape) != 1:
        raise InputError(
            f"{path}: holds {shown(str(dtype))} {list(shape)}, expected an array of texts [N]"
        )
    array = read_array(data, path, "US", "texts")
    try:
        names = array.astype(str) if dtype.kind == "U" else np.char.decode(array, "utf-8")
    except ValueError as error:
        raise InputError(f"{path}: is not a readable .npy file ({reason(error)})") from None
    return [str(name).strip() for name in names if str(name).strip()]
