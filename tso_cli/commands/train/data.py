"""The data sets of `tso train` and `tso curves`, as their options choose them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from ...datasets.items import Dataset
from ...datasets.opening import open_dataset
from ...datasets.splits import read_part
from ...errors import InputError
from ...io.shipped import example_meshes
from ...network import Background
from ...train.backgrounds import Backgrounds
from ...train.data import TrainingData
from ...train.sources import from_meshes
from ..options import ProgressBar, log


@dataclass(frozen=True)
class DataSelection:
    """A choice of objects from a data set, and how their pictures are prepared.

    Parameters
    ----------
    data : folder of the data set; None renders the shipped example meshes.
    split_file, part : take only the objects in the list ``part`` of the split.
    categories : take only these; empty takes all.
    strict : stop at the first unusable item instead of skipping it.
    crop_share, background : see `network_input`.
    behind : folder of photos, or "textures", to put the objects on.
    points : skip objects without a 3D file.
    """

    data: Path | None
    split_file: Path | None = None
    categories: tuple[str, ...] = ()
    strict: bool = False
    crop_share: float = 0.9
    background: Background = "black"
    behind: str | None = None
    part: str = "train"
    points: bool = False

    def __post_init__(self) -> None:
        if not 0.0 <= self.crop_share <= 1.0:
            raise InputError(f"--crop-share is {self.crop_share:g}, expected 0 to 1")


def load(selection: DataSelection, quiet: bool = False) -> TrainingData:
    """Open the data set, or render the shipped meshes; ten skipped items are named on stderr."""
    if selection.data is None:
        if selection.split_file is not None or selection.categories or selection.behind is not None:
            raise InputError(
                "--split, --category or --backgrounds without DATA, expected a data set"
            )
        meshes = example_meshes()
        description = f"{len(meshes)} shipped example meshes"
        if not quiet:
            log(f"tso: no DATA: rendering the {description}")
        bar = None if quiet else ProgressBar("render")
        return from_meshes(
            meshes, description, selection.crop_share, selection.background, progress=bar
        )
    dataset = _select(selection, selection.data)
    if dataset.skipped and not quiet:
        for item, reason in list(dataset.skipped.items())[:10]:
            log(f"tso: {reason if item in reason else f'{item}: {reason}'}; left out")
        log(
            f"tso: {len(dataset.skipped)} items left out in all "
            "(--strict stops at the first, --json names all)"
        )
    backgrounds = (
        None if selection.behind is None else Backgrounds(selection.behind, selection.strict)
    )
    description = f"{dataset.description}: {len(dataset.objects)} objects"
    pictures = (selection.crop_share, selection.background, selection.strict, backgrounds)
    return TrainingData(dataset.objects, description, *pictures, dataset.skipped, dataset.scale)


def _select(selection: DataSelection, folder: Path) -> Dataset:
    dataset = open_dataset(folder, selection.strict, own_scale=selection.crop_share == 0.0)
    categories = selection.categories
    if categories:
        known = sorted({item.category for item in dataset.objects})
        if unknown := [name for name in categories if name not in known]:
            raise InputError(
                f"{folder}: has no category {unknown[0]!r}, expected one of {', '.join(known)}"
            )
        dataset = replace(
            dataset, objects=[item for item in dataset.objects if item.category in categories]
        )
    if selection.split_file is not None:
        names = read_part(selection.split_file, selection.part)
        # The split may name objects of categories that were not loaded.
        names = [name for name in names if not categories or name.split("/")[0] in categories]
        dataset = dataset.select(names, str(selection.split_file))
    return dataset.with_points(selection.strict) if selection.points else dataset
