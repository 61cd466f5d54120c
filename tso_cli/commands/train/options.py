"""The options of `tso train` and `tso train-prior`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import click

from ...errors import InputError
from ...io.shipped import DEFAULT
from ...network import Background
from ...option import check_rules, opt
from ...train.config import TrainConfig
from ...train.prior.config import PriorConfig
from .. import options

# Without DATA: about two minutes on two cores, with a rate that suits 600 steps (both measured).
EXAMPLE_DEFAULTS = {"steps": 600, "learning_rate": 3e-4, "averaging": 0.99}

OUTPUT: dict[str, Any] = dict(heading="Output", names=("-o", "output"), brief=True, role="output")
INITIAL: dict[str, Any] = dict(
    names=("init",), words=(DEFAULT,), brief=True, role="input", excludes=("resume",)
)


class CategoryValue(click.ParamType):
    """``airplane=0.1``."""

    name = "category=value"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[str, float]:
        category, _, number = str(value).partition("=")
        try:
            return category, float(number)
        except ValueError:
            self.fail(
                f"{value!r} is no category and number, expected such as airplane=0.1", param, ctx
            )


@dataclass(frozen=True, kw_only=True)
class TrainOptions(TrainConfig):
    """What `tso train` may be given; InputError for options that do not go together.

    split_file : Train only on the objects in the list "train" of this split (.json).
    data : Folder of the data set.
    categories : Train only on this category. May be repeated.
    crop_share : Crop each picture so that the object's longer side takes this share of it, and
        scale clouds to longest side 1. 0: objects and clouds keep their sizes.
    background : Background of the pictures.
    behind : Put the objects on crops of the photos in FOLDER, or on generated textures.
    mask_data : Data set of images with one mask each.
    mask_split : Take from --mask-data only the list "train" of this split (.json).
    variances : Another --sigma-sq for one category. May be repeated.
    strict : Stop at the first unusable file instead of skipping it.
    initial : Start from the weights of this checkpoint, or of the shipped one (`default`).
    output : Checkpoint to write (.safetensors).
    checkpoint_every : Save after every N steps; 0: only at the end.
    resume : Continue the training that `output` belongs to.
    log_file : File for the settings and the losses of every step (.jsonl).
    """

    data: Path | None = opt(None, role="argument")
    split_file: Path | None = opt(None, heading="Data", names=("split",), brief=True, role="input")
    categories: tuple[str, ...] = opt((), names=("category",), metavar="NAME", brief=True)
    strict: bool = opt(False)
    crop_share: float = opt(0.9, heading="Input pictures", least=0.0, most=1.0)
    background: Background = opt("black")
    behind: str | None = opt(
        None, names=("backgrounds",), metavar="FOLDER|textures", only={"background": ("keep",)}
    )
    mask_data: Path | None = opt(
        None, heading="Supervision", only={"supervision": ("joint",)}, role="input"
    )
    mask_split: Path | None = opt(None, needs=("mask_data",), role="input")
    variances: tuple[Any, ...] = opt(
        (),
        heading="Losses",
        names=("category_sigma_sq",),
        parser=CategoryValue(),
        only={"supervision": ("masks", "joint")},
    )
    initial: Path | None = opt(None, "random weights", **INITIAL)
    output: Path = opt(Path("base.safetensors"), **OUTPUT)
    overwrite: bool = options.overwrite()
    checkpoint_every: int = opt(500, least=0)
    resume: bool = opt(False, brief=True)
    log_file: Path | None = opt(None, brief=True, role="output")
    as_json: bool = options.as_json()

    def __post_init__(self) -> None:
        super().__post_init__()
        check_rules(self)
        if self.supervision == "joint" and self.mask_data is None:
            raise InputError("`supervision` is joint, expected --mask-data FOLDER with it")

    def on_examples(self, given: Mapping[str, Any]) -> TrainOptions:
        """The same without DATA, with other defaults for what is not ``given``."""
        others: dict[str, Any] = {
            name: value for name, value in EXAMPLE_DEFAULTS.items() if name not in given
        }
        return replace(self, **others)


@dataclass(frozen=True, kw_only=True)
class TrainPriorOptions(PriorConfig):
    """What `tso train-prior` may be given; InputError for options that do not go together.

    split_file : Train only on the objects in the list "train" of this split (.json).
    meshes : Meshes, FOLDER/CATEGORY/NAME.
    without : Leave out this category. May be repeated.
    predictor : Let some starts be predictions of this network, or of the shipped one (`default`),
        from pictures of the meshes.
    workers : Threads that share each step.
    strict : Stop at the first unusable file instead of skipping it.
    start : Start from the weights of this prior, or of the shipped one (`default`).
    output : Prior to write (.safetensors).
    checkpoint_every : Save after every N steps; 0: only at the end.
    resume : Continue the training that `output` belongs to.
    log_file : File for the settings and the losses of every step (.jsonl).
    """

    meshes: Path | None = opt(None, role="argument")
    split_file: Path | None = opt(None, heading="Data", names=("split",), brief=True, role="input")
    without: tuple[str, ...] = opt((), metavar="NAME", brief=True)
    strict: bool = opt(False)
    predictor: Path | None = opt(
        None, names=("predicted_by",), words=(DEFAULT,), metavar="default|CHECKPOINT", role="input"
    )
    start: Path | None = opt(None, "random weights", **INITIAL)
    output: Path = opt(Path("prior.safetensors"), **OUTPUT)
    overwrite: bool = options.overwrite()
    checkpoint_every: int = opt(500, least=0)
    resume: bool = opt(False, brief=True)
    log_file: Path | None = opt(None, brief=True, role="output")
    as_json: bool = options.as_json()
    workers: int = opt(1, heading="Running", least=1)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.meshes is None and not self.by_rule:
            raise InputError("no MESHES were given, expected their folder, or --by-rule N")
        if self.predictions != PriorConfig.predictions and self.predictor is None:
            raise InputError(
                "`predictions` counts what a network predicts, expected --predicted-by too"
            )
