"""`tso train`: train the network that predicts a cloud from a photo."""

from __future__ import annotations

import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click

from .. import options
from .options import TrainOptions
from .recipes import RECIPE, recipe_option, render

if TYPE_CHECKING:
    from ...network.model import NetworkConfig
    from ...train.config import TrainConfig
    from ...train.data import TrainingData
    from ...train.state import TrainingState
    from .outputs import TrainOutputs


@options.command("train", TrainOptions, recipe_option("network", TrainOptions))
def command(ctx: click.Context, chosen: TrainOptions) -> None:
    """Train the network that predicts a cloud from a photo, for the network modes of `tso refine`.

    DATA is a folder that `tso render` wrote, or ShapeNet, 3D-R2N2 or Pix3D as they are distributed.
    Without DATA, the shipped example meshes are rendered, and training on them takes about two
    minutes.

    The state of the training is stored next to the checkpoint, as NAME.training.safetensors, for
    --resume. Ctrl-C finishes the current step and writes both files.

    To train the network with several processes: torchrun --nproc-per-node N -m tso_cli train ...
    """
    from ...train.config import TrainConfig
    from ...train.loop import train
    from ...train.processes import joined
    from ...train.state import stored_window
    from .data import DataSelection, load
    from .outputs import TrainOutputs
    from .report import print_summary, training_document, unusable

    started = time.perf_counter()
    recipe = ctx.meta.get(RECIPE)
    if recipe is not None and recipe.render is not None:
        chosen = replace(chosen, data=render(recipe, chosen.data, chosen.output))
    if on_examples := chosen.data is None:
        chosen = chosen.on_examples(options.explicit_options(ctx))
    outputs = options.pick(TrainOutputs, vars(chosen))
    settings = vars(chosen) | {
        "recipe": recipe and recipe.name,
        "category_sigma_sq": dict(chosen.variances),
    }
    if outputs.resume and chosen.saturation_steps is None:
        settings["saturation_steps"] = stored_window(outputs.output)
    with joined(chosen.device) as (processes, settings["device"]):
        config = options.pick(TrainConfig, settings)
        if processes.first:
            outputs.check()
        processes.wait()
        quiet = not processes.first
        selection = options.pick(
            DataSelection, {**vars(chosen), "points": config.supervision != "masks"}
        )
        sets = [load(selection, quiet=quiet)]
        if chosen.mask_data is not None:
            masked = replace(
                selection, data=chosen.mask_data, split_file=chosen.mask_split, categories=(),
                behind=None, points=False,
            )  # fmt: skip
            sets.append(load(masked, quiet=quiet))
        data, masked_data = sets[0], sets[1] if len(sets) > 1 else None
        state = _initial_state(data, config, outputs, chosen.initial)
        if outputs.resume and not quiet:
            outputs.log_resumed(state.step, config.steps)
        prepared, first_step = time.perf_counter(), state.step
        with options.naming(outputs.output):
            result = train(
                data,
                config,
                state,
                masked=masked_data,
                processes=processes,
                progress=options.ProgressBar("train"),
                save=partial(_save, outputs),
                save_every=chosen.checkpoint_every,
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
    if chosen.as_json:
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
    from ...train.state import save_training, write_history

    outputs.save(
        lambda path, overwrite: save_training(path, state, config, overwrite),
        lambda path, overwrite: write_history(path, state.history, config, overwrite),
    )


def _initial_state(
    data: TrainingData, config: TrainConfig, outputs: TrainOutputs, initial: Path | None
) -> TrainingState:
    """The state next to the checkpoint to resume from, or a new state."""
    from ... import device as devices
    from ...io.checkpoints import load_network
    from ...io.shipped import named_checkpoint
    from ...train.loop import network_config, start
    from ...train.state import load_training

    if not outputs.resume:
        return start(data, config, load_network(named_checkpoint(initial))[0] if initial else None)
    about = network_config(data, config, 0)
    device = devices.for_training(config.device, config.precision)
    return load_training(outputs.output, about, data.fingerprint(), device)
