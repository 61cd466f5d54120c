"""`tso train-prior`: train the prior that moves a start to a likely shape."""

from __future__ import annotations

import math
import os
import time
from collections import Counter
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ...errors import InputError
from .. import options
from .options import TrainPriorOptions
from .recipes import RECIPE, recipe_option

if TYPE_CHECKING:
    from ...train.prior.shapes import ShapeSet
    from ...train.prior.state import PriorState

LOSS_STEPS = 100  # the loss that is reported is the mean over this many steps
LISTED = 10  # meshes that were left out and are named on stderr


@options.command("train-prior", TrainPriorOptions, recipe_option("prior", TrainPriorOptions))
def command(ctx: click.Context, chosen: TrainPriorOptions) -> None:
    """Train the prior that moves a cloud to a likely shape before `tso refine` optimises it.

    \b
    tso train-prior MESHES -o my.safetensors
    tso train-prior --by-rule 24 -o my.safetensors
    tso train-prior MESHES --config prior -o prior.safetensors

    MESHES is a folder of meshes, CATEGORY/NAME; with --by-rule shapes are made by rule too, or
    alone. The state of the training is stored next to the prior, as NAME.training.safetensors, for
    --resume. Ctrl-C finishes the current step and writes both files.
    """
    from ... import device as devices
    from ...datasets.splits import read_part
    from ...io.reading import name_of
    from ...io.shipped import DEFAULT
    from ...prior.file import EXPECTED, read_prior, shipped_prior
    from ...prior.network import initial as random_weights
    from ...train.prior.bank import build_bank
    from ...train.prior.config import PriorConfig
    from ...train.prior.loop import train
    from ...train.prior.predictions import Predictor, draw_predictions
    from ...train.prior.scenes import Chances
    from ...train.prior.shapes import ShapeSet, read_shapes, ruled_shapes
    from ...train.prior.state import (
        check_resumable,
        load_training,
        new_state,
        save_training,
        write_history,
    )
    from .outputs import TrainOutputs

    started = time.perf_counter()
    if int(os.environ.get("WORLD_SIZE", "1")) > 1:
        raise InputError(
            f"tso train-prior with {os.environ['WORLD_SIZE']} processes, expected one: start it "
            "without torchrun"
        )
    outputs = options.pick(TrainOutputs, vars(chosen))
    outputs.check()
    predictor = Predictor.read(chosen.predictor) if chosen.predictor else None
    initial = shipped_prior() if str(chosen.start) == DEFAULT else chosen.start
    recipe = ctx.meta.get(RECIPE)
    config = options.pick(
        PriorConfig,
        vars(chosen)
        | {
            "predicted_by": predictor and predictor.name,
            "initial": initial and name_of(initial, EXPECTED),
            "recipe": recipe and recipe.name,
        },
    )
    device = devices.for_training(config.device, config.precision)
    weights = read_prior(initial)[0] if initial else random_weights(config.seed)
    if outputs.resume:
        about_state = check_resumable(outputs.output, config)
        config = replace(config, initial=about_state["settings"].get("initial"))
    folder, without = chosen.meshes, chosen.without
    shapes = ShapeSet([])
    if folder is not None:
        names = read_part(chosen.split_file, "train") if chosen.split_file else None
        bar = options.ProgressBar("read meshes")
        shapes = read_shapes(folder, without, chosen.strict, bar, names)
    about = _description(folder, shapes, config.by_rule)
    if config.by_rule:
        bar = options.ProgressBar("make shapes")
        shapes = shapes + ruled_shapes(config.by_rule, config.seed, without, bar)
    if outputs.resume:
        state = load_training(outputs.output, config, weights, shapes.fingerprint(), device)
        outputs.log_resumed(state.step, config.steps)
    else:
        state = new_state(weights, shapes.fingerprint(), device)
    _log_skipped(shapes)

    def save(state: PriorState) -> None:
        outputs.save(
            lambda path, overwrite: save_training(path, state, config, about, overwrite),
            lambda path, overwrite: write_history(path, state, config, about, overwrite),
        )

    prepared, first_step, stop_reason = time.perf_counter(), state.step, "max_steps"
    if state.step >= config.steps:
        save(state)
    else:
        predict = None
        if predictor is not None:
            predict = partial(
                draw_predictions,
                predictor,
                shapes,
                count=config.predictions,
                seed=config.seed,
                progress=options.ProgressBar("predict starts"),
            )
        drawing = options.ProgressBar("draw scenes")
        chances = options.pick(Chances, vars(chosen))
        bank = build_bank(
            shapes,
            config.scenes,
            config.seed,
            device,
            drawing,
            predict,
            chosen.workers,
            chances,
        )
        prepared = time.perf_counter()
        with options.naming(outputs.output):
            stop_reason = train(
                bank,
                config,
                state,
                progress=options.ProgressBar("train"),
                save=save,
                save_every=chosen.checkpoint_every,
                workers=chosen.workers,
            )
    seconds = {"prepare": prepared - started, "train": time.perf_counter() - prepared}
    document = _document(state, shapes, about) | {
        "output": outputs.output,
        "stop_reason": stop_reason,
        "steps_of_this_run": state.step - first_step,
        "settings": config.settings() | {"device": config.device},
        "seconds": seconds,
    }
    if chosen.as_json:
        options.echo_json(document)
    else:
        _print_summary(document)
    if stop_reason == "interrupted":
        options.log(
            f"tso: interrupted after {state.step} of {config.steps} steps; {outputs.output} and "
            "its state were written. Run the same command with --resume to continue"
        )
        ctx.exit(130)


def _log_skipped(shapes: ShapeSet) -> None:
    """Name what was left out on stderr."""
    for reason in list(shapes.skipped.values())[:LISTED]:
        options.log(f"tso: {reason}; left out")
    if len(shapes.skipped) > LISTED:
        options.log(f"tso: {len(shapes.skipped)} left out in all (--json names all)")


def _description(folder: Path | None, shapes: ShapeSet, by_rule: int) -> str:
    """The shapes in words, such as `meshes: 35 meshes of airplane, chair; 24 of each family`."""
    parts = []
    if folder is not None:
        categories = sorted({shape.category for shape in shapes.shapes})
        meshes = f"{len(shapes.shapes)} meshes of {', '.join(categories)}"
        parts.append(f"{folder.resolve().name}: {meshes}")
    if by_rule:
        parts.append(f"{by_rule} shapes of each family")
    return "; ".join(parts)


def _document(state: PriorState, shapes: ShapeSet, about: str) -> dict[str, Any]:
    """What the JSON document says about state and shapes."""
    from ...version import __version__

    rows = state.history[-LOSS_STEPS:]
    means = [sum(column) / len(rows) for column in zip(*rows, strict=True)] or [math.nan]
    return {
        "steps": state.step,
        "loss": sum(means),
        "left": means[0],
        "training_set": about,
        "categories": dict(sorted(Counter(shape.category for shape in shapes.shapes).items())),
        "left_out": shapes.skipped,
        "version": __version__,
    }


def _print_summary(document: dict[str, Any]) -> None:
    """Print the document for people."""
    steps, seconds = document["steps"], document["seconds"]["train"]
    click.echo(
        f"{document['output']}: {steps} steps in {seconds:.0f} s, {document['training_set']}"
    )
    click.echo(
        f"{document['left']:.3f} of the error of the starts is left, mean of the last "
        f"{min(LOSS_STEPS, steps)} steps (a prior that moves nothing leaves about 0.9)"
    )
