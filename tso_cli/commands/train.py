"""`tso train`: train the network that predicts a cloud from a photo, or a learned prior."""

from __future__ import annotations

import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ..errors import InputError
from . import options
from .options import PATH, choice, flag, option, output
from .recipes import RECIPE, RECIPES, read_recipe, render
from .train_outputs import TrainOutputs
from .train_prior import PRIOR_DEFAULTS, check_prior, train_prior

if TYPE_CHECKING:
    from ..network.model import NetworkConfig
    from ..train import TrainConfig
    from ..train.data import TrainingData
    from ..train.state import TrainingState

DEFAULTS: dict[str, Any] = {
    "steps": 20_000, "learning_rate": 5e-5, "averaging": 0.0, "batch_size": 16,
    "output": Path("base.safetensors"),
}  # fmt: skip
# Without DATA: about two minutes on two cores, with a rate that suits 600 steps (both measured).
EXAMPLE_DEFAULTS = {"steps": 600, "learning_rate": 3e-4, "averaging": 0.99}
# Option -> the only supervisions that use it.
SERVES = {
    **dict.fromkeys(
        ("affinity_weight", "affinity", "saturation_steps", "category_sigma_sq"), ("masks", "joint")
    ),
    "mask_split": ("joint",),
    "views": ("masks",),
}
HEADINGS = {
    "split_file": "Data", "prior": "Prior of shapes", "crop_share": "Input pictures",
    "supervision": "Supervision", "affinity_weight": "Losses", "points": "Network",
    "steps": "Optimisation", "output": "Output", "device": "Running",
}  # fmt: skip
# The options that --help shows.
BRIEF = (
    "split_file", "categories", "prior", "without", "augment", "supervision", "initial",
    "steps", "batch_size", "output", "overwrite", "resume", "log_file", "as_json", "device",
)  # fmt: skip


def _default(name: str) -> str:
    """The defaults of an option that has others without DATA or with --prior, for its help."""
    shown = [_shown(DEFAULTS[name])]
    for values, when in ((EXAMPLE_DEFAULTS, "without DATA"), (PRIOR_DEFAULTS, "with --prior")):
        if name in values:
            shown.append(f"{_shown(values[name])} {when}")
    return f"[default: {'; '.join(shown)}]"


def _shown(value: Any) -> str:
    return str(value) if isinstance(value, Path) else f"{value:g}"


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


@click.command("train", cls=options.Command, headings=HEADINGS, brief=BRIEF)
@click.argument("data", required=False, type=PATH)
@option(
    "--config",
    "Options from a file, unless they are given here: TOML or JSON. `network` and `prior` come "
    "with the program.",
    type=options.FilePath(*RECIPES),
    is_eager=True,
    expose_value=False,
    callback=read_recipe,
    metavar="network|prior|FILE",
)
@option(
    "--split",
    'Train only on the objects in the list "train" of this split (.json).',
    "split_file",
    type=PATH,
)
@option(
    "--category",
    "Train only on this category. May be repeated.",
    "categories",
    multiple=True,
    metavar="NAME",
)
@flag("--strict", "Stop at the first unusable file instead of skipping it.")
@flag("--balance", "Draw every category equally often, however many objects it has.")
@option(
    "--prior",
    "Train a learned prior in place of the network, from the meshes FOLDER/CATEGORY/NAME.",
    type=PATH,
    metavar="FOLDER",
)
@option(
    "--by-rule",
    "Shapes of each family that a prior learns from, with or without --prior; `tso render "
    "--family list` names the families.",
    type=options.Whole(0),
    default=0,
)
@option(
    "--marred",
    "Share of the masks of a prior's scenes that have a trouble, such as an arm or a hole.",
    default=0.4,
)
@option("--depth-maps", "Share of a prior's scenes that have depth maps.", default=0.4)
@option("--scenes", "Scenes to draw before the training of a prior; 1,000 take 40 s.", default=8000)
@option(
    "--without",
    "Leave out this category of --prior. May be repeated.",
    multiple=True,
    metavar="NAME",
)
@option(
    "--predicted-by",
    "Let some starts of --prior be predictions of this network, or of the shipped one (`default`), "
    "from pictures of the meshes.",
    type=options.FilePath(*options.WORDS["checkpoint"]),
    metavar="default|CHECKPOINT",
)
@option("--predictions", "Most predictions of --predicted-by; 100 take 10 s.", default=1600)
@option(
    "--crop-share",
    "Crop each picture so that the object's longer side takes this share of it, and scale "
    "clouds to longest side 1. 0: objects and clouds keep their sizes.",
    default=0.9,
)
@choice("--background", "Background of the pictures.", "black", "white", "keep")
@option(
    "--backgrounds",
    "Put the objects on crops of the photos in FOLDER, or on generated textures; needs "
    "--background keep.",
    "behind",
    metavar="FOLDER|textures",
)
@flag("--augment", "Mirror and recolour the pictures at random.")
@choice(
    "--supervision",
    "What the loss compares with: the true points, masks, or both (needs --mask-data).",
    "points",
    "masks",
    "joint",
)
@option(
    "--views", "Masks to compare each object with in a step, for --supervision masks.", default=4
)
@option("--mask-data", "Data set of images with one mask each, for --supervision joint.", type=PATH)
@option(
    "--mask-split", 'Take from --mask-data only the list "train" of this split (.json).', type=PATH
)
@option(
    "--lambda",
    "Weight of the affinity loss. Once the loss saturates, the weight drops to 2 % of this.",
    "affinity_weight",
    default=1.0,
)
@choice(
    "--affinity",
    "Form of the affinity loss: between points and mask, or the paper's, between pairs of pixels.",
    "points",
    "paper",
)
@option(
    "--saturation-steps",
    "The loss is saturated if its mean over this number of steps is less than 1 % below the "
    "mean over as many steps before.  [default: a sixth of --steps, 10 to 500]",
    type=int,
)
@option("--sigma-sq", "Variance of the projector's Gaussian, px^2 of a 64x64 mask.", default=0.4)
@option(
    "--category-sigma-sq",
    "Another --sigma-sq for one category. May be repeated.",
    multiple=True,
    type=CategoryValue(),
)
@option("--points", "Points of the predicted cloud.", default=1024)
@choice(
    "--frame",
    "Axes of the predicted cloud: the camera's (view) or the object's (canonical).",
    "view",
    "canonical",
)
@option(
    "--init",
    "Start from the weights of this checkpoint or prior, or of the shipped one (`default`).  "
    "[default: random weights]",
    "initial",
    type=PATH,
)
@choice(
    "--decay",
    "How the learning rate falls: not at all, or to 0 along half a cosine.",
    "none",
    "cosine",
)
@option("--steps", f"Optimiser steps in all.  {_default('steps')}", type=int)
@option("--batch-size", f"Objects in a step.  {_default('batch_size')}", type=int)
@option("--learning-rate", f"Learning rate of Adam.  {_default('learning_rate')}", type=float)
@option(
    "--averaging",
    "Save the moving average of the weights with this decay. 0: save the last weights.  "
    f"{_default('averaging')}",
    type=float,
)
@choice(
    "--precision",
    "Number format of the network's layers; bfloat16 is mixed precision.",
    "float32",
    "bfloat16",
)
@output(f"Checkpoint or prior to write (.safetensors).  {_default('output')}")
@options.overwrite
@option(
    "--checkpoint-every",
    "Save after every N steps; 0: only at the end.",
    type=options.Whole(0),
    default=500,
)
@flag("--resume", "Continue the training that --output belongs to.")
@option("--log-file", "File for the settings and the losses of every step (.jsonl).", type=PATH)
@options.as_json
@options.device
@options.seed
@option(
    "--workers", "Threads that prepare batches ahead; of a prior, that share each step.", default=1
)
@click.pass_context
def command(ctx: click.Context, as_json: bool, **chosen: Any) -> None:
    """Train the network that predicts a cloud from a photo, for the network modes of `tso refine`.

    DATA is a folder that `tso render` wrote, or ShapeNet, 3D-R2N2 or Pix3D as they are distributed.
    Without DATA, the shipped example meshes are rendered, and training on them takes about two
    minutes.

    The state of the training is stored next to the checkpoint, as NAME.training.safetensors, for
    --resume. Ctrl-C finishes the current step and writes both files.

    With --prior FOLDER it trains the prior that moves a cloud to a likely shape before
    `tso refine` optimises it.

    To train the network with several processes: torchrun --nproc-per-node N -m tso_cli train ...
    """
    recipe = ctx.meta.get(RECIPE)
    chosen["recipe"] = recipe and recipe.name
    check_prior(ctx)
    if chosen["prior"] is not None or chosen["by_rule"]:
        train_prior(ctx, as_json, chosen)
        return
    from ..train import TrainConfig, train
    from ..train.processes import joined
    from ..train.state import stored_window
    from .train_report import print_summary, training_document, unusable
    from .training_data import DataSelection, load

    started = time.perf_counter()
    if recipe is not None and recipe.render is not None:
        chosen["data"] = render(recipe, chosen["data"], chosen["output"] or DEFAULTS["output"])
    on_examples = chosen["data"] is None
    for name, value in (DEFAULTS | (EXAMPLE_DEFAULTS if on_examples else {})).items():
        chosen[name] = value if chosen[name] is None else chosen[name]
    outputs = options.pick(TrainOutputs, chosen)
    if outputs.resume and chosen["saturation_steps"] is None:
        chosen["saturation_steps"] = stored_window(outputs.output)
    chosen["category_sigma_sq"] = dict(chosen["category_sigma_sq"])
    with joined(chosen["device"]) as (processes, chosen["device"]):
        config = options.pick(TrainConfig, chosen)
        _check_supervision(ctx, config.supervision, chosen["mask_data"])
        if processes.first:
            outputs.check()
        processes.wait()
        quiet = not processes.first
        selection = options.pick(DataSelection, {**chosen, "points": config.supervision != "masks"})
        sets = [load(selection, quiet=quiet)]
        if chosen["mask_data"] is not None:
            masked = {
                "data": chosen["mask_data"],
                "split_file": chosen["mask_split"],
                "categories": (),
            }
            sets.append(load(replace(selection, **masked, behind=None, points=False), quiet=quiet))
        data, masked_data = sets[0], sets[1] if len(sets) > 1 else None
        state = _initial_state(data, config, outputs, chosen["initial"])
        if outputs.resume and not quiet:
            options.log(f"tso: resuming after {state.step} steps")
        prepared, first_step = time.perf_counter(), state.step
        bar, saves = (
            options.ProgressBar("train"),
            {"save": partial(_save, outputs), "save_every": chosen["checkpoint_every"]},
        )
        with options.naming(outputs.output):
            result = train(
                data, config, state, masked=masked_data, processes=processes, progress=bar, **saves
            )
    if not processes.first:
        return
    trained = time.perf_counter()
    document = training_document(result, config, outputs.output, data, on_examples)
    document["seconds"] = {
        "prepare": prepared - started,
        "train": trained - prepared,
        "judge": time.perf_counter() - trained,
    }
    images = (result.steps - first_step) * config.batch_size
    document["images_per_second"] = images / (trained - prepared)
    left_out = unusable(sets)
    document["left_out"] = {
        item: why for each in sets for item, why in each.skipped.items()
    } | left_out
    if left_out:
        options.log(
            f"tso: {len(left_out)} pictures could not be used and were left out "
            "(--strict stops at the first)"
        )
    if as_json:
        options.echo_json(document)
    else:
        print_summary(document)
    if result.stop_reason == "interrupted":
        options.log(
            f"tso: interrupted after {result.steps} of {config.steps} steps; {outputs.output} and "
            "its state were written. Run the same command with --resume to continue"
        )
        ctx.exit(130)


def _save(outputs: TrainOutputs, state: TrainingState, config: NetworkConfig) -> None:
    """Write checkpoint, state and log."""
    from ..train.state import save_training, write_history

    outputs.save(
        lambda path, overwrite: save_training(path, state, config, overwrite),
        lambda path, overwrite: write_history(path, state.history, config, overwrite),
    )


def _check_supervision(ctx: click.Context, supervision: str, mask_data: Path | None) -> None:
    """InputError if the supervision lacks an option that it needs, or has one that it ignores."""
    if (supervision == "joint") != (mask_data is not None):
        expected = "--mask-data FOLDER with it" if mask_data is None else "joint with --mask-data"
        raise InputError(f"--supervision is {supervision}, expected {expected}")
    for parameter in ctx.command.params:
        name = parameter.name or ""
        used = ctx.get_parameter_source(name) is click.core.ParameterSource.COMMANDLINE
        if used and supervision not in SERVES.get(name, (supervision,)):
            raise InputError(
                f"{parameter.opts[0]} is for --supervision {' or '.join(SERVES[name])}, "
                f"found {supervision}"
            )


def _initial_state(
    data: TrainingData, config: TrainConfig, outputs: TrainOutputs, initial: Path | None
) -> TrainingState:
    """The state next to the checkpoint to resume from, or a new state."""
    from .. import device as devices
    from ..io.checkpoints import load_network
    from ..io.shipped import named_checkpoint
    from ..train import network_config, start
    from ..train.state import load_training

    if not outputs.resume:
        return start(data, config, load_network(named_checkpoint(initial))[0] if initial else None)
    if initial is not None:
        raise InputError(
            "--init with --resume: the state to resume has weights of its own, "
            "expected one of the two"
        )
    about = network_config(data, config, 0)
    return load_training(outputs.output, about, data.fingerprint(), devices.resolve(config.device))
