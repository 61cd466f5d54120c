"""Which predictions, targets, masks and cameras belong together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from ..errors import InputError
from ..geometry.view import View
from ..io.cameras import find_camera, named_masks
from ..io.clouds import ARRAYS, clouds_in
from ..io.masks import MaskChoice
from ..io.shapes import SUFFIXES, shape_kind
from ..io.views import ViewFiles, load_views

# In a folder a .txt file is more often a note than a cloud.
FOLDER_SUFFIXES = tuple(suffix for suffix in SUFFIXES if suffix != ".txt")
# Endings of the files that belong to a name, in the order in which they are tried.
MASKS = (
    ".png", ".mask.png", "/mask.png", ".npy", ".bmp", ".tif", ".tiff", ".webp", ".gif", ".jpg",
    ".jpeg",
)  # fmt: skip
CAMERAS = (".camera.json", ".json", "/camera.json", "/cameras.json")


@dataclass(frozen=True)
class Pair:
    """A prediction and its target, and for the IoU also the files of masks and cameras.

    index : of both clouds in arrays [B, N, 3], and of the mask if that is an array.
    """

    name: str
    prediction: Path
    target: Path
    mask: Path | None = None
    camera: Path | None = None
    index: int | None = None

    def views(self, choice: MaskChoice) -> list[View]:
        """The views of the mask, or of the masks that the camera file names.

        Raises InputError as `load_views`, or if there is no camera file.
        """
        masks = [self.mask] if self.mask else named_masks(self.camera) if self.camera else []
        for mask in masks:
            if self.camera is None and find_camera(mask) is None:
                names = f"{mask.stem}.camera.json or camera.json"
                raise InputError(f"{mask}: found no {names} next to it, expected one or `camera`")
        if self.index is not None and choice.index is None and masks[0].suffix.lower() in ARRAYS:
            choice = replace(choice, index=self.index)
        return load_views(ViewFiles(masks, self.camera, choice=choice))[0]


def find_pairs(
    prediction: Path,
    target: Path,
    mask: Path | None = None,
    camera: Path | None = None,
    suffix: str = "",
) -> list[Pair]:
    """Two files, or the files of two folders matched by name.

    A name is the path in the folder without its suffix. ``mask`` and ``camera`` are one file for
    all pairs, or a folder with one file for each name (NAME.png, NAME.camera.json and so on). With
    a ``suffix`` such as ".refined" only predictions whose names end in it are taken, and are
    matched without it.

    Raises InputError if the two sides do not match, or if a name has no mask or camera.
    """
    for path in (prediction, target, *(extra for extra in (mask, camera) if extra is not None)):
        if not path.exists():
            raise InputError(f"{path}: no such file or folder")
    if prediction.is_dir() != target.is_dir():
        folder, file = (prediction, target) if prediction.is_dir() else (target, prediction)
        raise InputError(
            f"{folder} is a folder and {file} a file, expected two files or two folders"
        )
    if prediction.is_dir():
        predictions, targets = _by_name(prediction, suffix), _by_name(target)
        _require_same_names(prediction, predictions, target, targets, suffix)
    elif suffix:
        raise InputError(f"`suffix` {suffix} matches names in folders, but {prediction} is a file")
    else:
        predictions, targets = {prediction.stem: prediction}, {prediction.stem: target}
    pairs = [
        Pair(
            name,
            path,
            targets[name],
            _companion(mask, name, MASKS, "mask"),
            _companion(camera, name, CAMERAS, "camera"),
        )
        for name, path in sorted(predictions.items())
    ]
    return [part for pair in pairs for part in _of_arrays(pair)]


def _of_arrays(pair: Pair) -> list[Pair]:
    """The pair, or if both files hold several clouds a pair for each of these."""
    files = pair.prediction, pair.target
    count, other = (clouds_in(path) if shape_kind(path) == "cloud" else 1 for path in files)
    if count != other:
        of_target = f"{pair.target} {other}, expected the same number"
        raise InputError(f"{pair.prediction} holds {count} shapes and {of_target}")
    several = [replace(pair, name=f"{pair.name}[{i}]", index=i) for i in range(count)]
    return several if count > 1 else [pair]


def _by_name(folder: Path, suffix: str = "") -> dict[str, Path]:
    paths: dict[str, Path] = {}
    for path in sorted(folder.rglob("*")):
        relative = path.relative_to(folder)
        name = relative.with_suffix("").as_posix()
        hidden = any(part.startswith(".") for part in relative.parts)
        if (
            hidden
            or path.suffix.lower() not in FOLDER_SUFFIXES
            or not name.endswith(suffix)
            or not path.is_file()
        ):
            continue
        name = name.removesuffix(suffix)
        if name in paths:
            raise InputError(
                f"{path} and {paths[name]} have the same name, expected one file for {name!r}"
            )
        paths[name] = path
    if not paths:
        ending = f"ending in {suffix} " if suffix else ""
        raise InputError(
            f"{folder}: no file {ending}to evaluate in this folder or its folders, "
            f"expected {', '.join(FOLDER_SUFFIXES)}"
        )
    return paths


def _require_same_names(
    prediction: Path,
    predictions: dict[str, Path],
    target: Path,
    targets: dict[str, Path],
    suffix: str,
) -> None:
    parts = []
    for folder, other, unmatched in (
        (prediction, target, predictions.keys() - targets.keys()),
        (target, prediction, targets.keys() - predictions.keys()),
    ):
        if names := sorted(unmatched):
            more = f" and {len(names) - 3} more" if len(names) > 3 else ""
            parts.append(f"{folder} has {', '.join(names[:3])}{more}, which {other} has not")
    if parts:
        refined = not suffix and any(name.endswith(".refined") for name in predictions)
        advice = " (`suffix` .refined takes predictions with this ending)" if refined else ""
        raise InputError("; ".join(parts) + ": expected the same names in both" + advice)


def _companion(path: Path | None, name: str, endings: Sequence[str], what: str) -> Path | None:
    """``path``, or if it is a folder the file in it that belongs to ``name``."""
    if path is None or not path.is_dir():
        return path
    for ending in endings:
        file = Path(f"{path / name}{ending}")
        if file.is_file():
            return file
    raise InputError(
        f"{path}: no {what} for {name!r}, expected {name}{endings[0]} or {name}{endings[1]}"
    )
