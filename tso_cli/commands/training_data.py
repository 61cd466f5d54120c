"""The training data that the options of a command ask for."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import InputError
from . import options

if TYPE_CHECKING:
    from ..datasets.items import Dataset
    from ..train.data import TrainingData


# Items left out that are named on stderr; of a hundred thousand many may be bad.
NAMED = 10


@dataclass(frozen=True)
class Wanted:
    """What to train or judge on.

    folder : of a data set; None is the shipped example meshes.
    split : file of a split, of which ``part`` is taken; None takes everything.
    categories : names; empty takes all.
    crop_share : 0 keeps sizes, in the picture and of the clouds.
    behind : a folder of photos, or "textures", to put the objects on.
    points : leave out objects without a 3D file.
    """

    folder: Path | None
    split: Path | None = None
    categories: tuple[str, ...] = ()
    strict: bool = False
    crop_share: float = 0.9
    background: str = "black"
    behind: str | None = None
    part: str = "train"
    points: bool = False

    def __post_init__(self) -> None:
        if not 0.0 <= self.crop_share <= 1.0:
            raise InputError(f"--crop-share is {self.crop_share:g}, expected 0 to 1")


def load(wanted: Wanted, quiet: bool = False) -> TrainingData:
    """Open the data set, or render the shipped meshes; what was left out is named on stderr."""
    from ..train.sources import from_dataset, from_meshes

    if wanted.folder is None:
        if wanted.split is not None or wanted.categories or wanted.behind is not None:
            raise InputError("--split, --category or --backgrounds without DATA, expected a data set")
        from ..io.shipped import example_meshes

        meshes = example_meshes()
        if not quiet:
            options.log(f"tso: no DATA: rendering the {len(meshes)} shipped example meshes")
        described = f"{len(meshes)} shipped example meshes"
        bar = None if quiet else options.ProgressBar("render")
        return from_meshes(meshes, described, wanted.crop_share, wanted.background, progress=bar)
    dataset = chosen(wanted)
    if not quiet:
        for item, reason in list(dataset.skipped.items())[:NAMED]:
            options.log(f"tso: {reason if item in reason else f'{item}: {reason}'}; left out")
        if dataset.skipped:
            options.log(f"tso: {len(dataset.skipped)} items left out in all (--strict stops at the first, --json names all)")
    behind = None
    if wanted.behind is not None:
        from ..train.backgrounds import Backgrounds

        behind = Backgrounds(wanted.behind, wanted.strict)
    return from_dataset(dataset, wanted.crop_share, wanted.background, wanted.strict, behind)


def chosen(wanted: Wanted) -> Dataset:
    """The objects of the data set that are wanted."""
    from dataclasses import replace

    from ..datasets.opening import open_dataset, read_part

    assert wanted.folder is not None
    dataset = open_dataset(wanted.folder, wanted.strict, own_scale=wanted.crop_share == 0.0)
    if wanted.categories:
        held = sorted({item.category for item in dataset.objects})
        unknown = [name for name in wanted.categories if name not in held]
        if unknown:
            raise InputError(f"{wanted.folder}: has no category {unknown[0]!r}, expected one of {', '.join(held)}")
        objects = [item for item in dataset.objects if item.category in wanted.categories]
        dataset = replace(dataset, objects=objects)
    if wanted.split is not None:
        names = read_part(wanted.split, wanted.part)
        # Of the other categories the split may name what is not here.
        own = [name for name in names if not wanted.categories or name.split("/")[0] in wanted.categories]
        dataset = dataset.select(own, str(wanted.split))
    return dataset.with_points(wanted.strict) if wanted.points else dataset
