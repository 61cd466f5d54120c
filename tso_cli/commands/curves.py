"""`tso curves`: the losses of trainings, and samples of a network."""

from __future__ import annotations

from pathlib import Path

import click

from ..errors import InputError
from . import options
from .options import PATH, option, output


@click.command("curves")
@click.argument("logs", nargs=-1, required=True, type=PATH)
@output("Picture to write (.png).", default="curves.png", show_default=True)
@option("--checkpoint", "Draw samples of this network too; needs --data.", type=PATH)
@option("--data", "Data set that the samples are from.", type=PATH)
@option(
    "--split",
    'Take the samples from the list "test" of this split (.json).',
    "split_file",
    type=PATH,
)
@option(
    "--samples",
    "Number of samples, 1 to 50.",
    "count",
    type=options.Whole(1, 50),
    default=6,
    show_default=True,
)
@options.overwrite
def command(
    logs: tuple[Path, ...], output: Path, overwrite: bool, count: int, **chosen: Path | None
) -> None:
    """Draw the losses of trainings.

    LOGS are files that `tso train --log-file` wrote. The picture shows every value and a running
    mean.

    With --checkpoint and --data a second picture, NAME.samples.png, shows what the network
    predicts: input, prediction and target, seen from two sides.
    """
    from ..io.checkpoints import load_network
    from ..io.logs import read_log
    from ..io.shipped import named_checkpoint
    from ..plots.curves import (
        draw_curves,
        draw_samples,
        labels,
        lambda_drop,
        running_mean,
        sample_predictions,
    )

    checkpoint, data, split_file = (chosen[name] for name in ("checkpoint", "data", "split_file"))
    if (checkpoint is None) != (data is None):
        raise InputError(
            "samples need a network and pictures, expected --checkpoint and --data together"
        )
    if split_file is not None and data is None:
        raise InputError("--split without --data, expected a data set to choose from")
    pictures = output.with_name(f"{output.stem}.samples.png")
    for path in (output, pictures) if checkpoint else (output,):
        options.require_output(path, ".png", overwrite)
    histories = [read_log(path) for path in logs]
    samples, scale = [], ""
    if checkpoint and data:
        from .training_data import DataSelection, load

        network, config = load_network(named_checkpoint(checkpoint))
        selection = DataSelection(
            data,
            split_file,
            crop_share=config.crop_share,
            background=config.background,
            part="test",
        )
        training = load(selection)
        samples = sample_predictions(network, training, config.frame, count)
        scale = training.scale
    draw_curves(output, histories, overwrite)
    for name, log in zip(labels(histories), histories, strict=True):
        losses, drop = log.columns["loss"], lambda_drop(log)
        dropped = "" if drop is None else f", lambda dropped before step {drop}"
        last = running_mean(losses, max(1, len(losses) // 50))[-1]
        click.echo(
            f"{name}: {len(losses)} steps, {log.settings['supervision']}, "
            f"loss {losses[0]:.4g} to {last:.4g}{dropped}"
        )
    if samples:
        draw_samples(pictures, samples, scale, overwrite)
        click.echo(f"{pictures}: {len(samples)} samples of {checkpoint}, {scale}")
