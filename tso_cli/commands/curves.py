"""`tso curves`: the losses of trainings, and samples of a network."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import click

from ..option import check, opt
from . import options


@dataclass(frozen=True, kw_only=True)
class CurvesOptions:
    """What `tso curves` may be given; InputError for options that do not go together.

    output : Picture to write (.png).
    checkpoint : Draw samples of this network too; needs --data.
    data : Data set that the samples are from.
    split_file : Take the samples from the list "test" of this split (.json).
    count : Number of samples, 1 to 50.
    """

    logs: tuple[Path, ...] = opt(options.REQUIRED, role="argument")
    output: Path = opt(Path("curves.png"), names=("-o", "output"))
    checkpoint: Path | None = opt(None, needs=("data",))
    data: Path | None = opt(None, needs=("checkpoint",))
    split_file: Path | None = opt(None, names=("split",), needs=("data",))
    count: int = opt(6, names=("samples",), least=1, most=50)
    overwrite: bool = options.overwrite()

    def __post_init__(self) -> None:
        check(self)


@options.command("curves", CurvesOptions)
def command(ctx: click.Context, chosen: CurvesOptions) -> None:
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

    checkpoint, output, overwrite = chosen.checkpoint, chosen.output, chosen.overwrite
    pictures = output.with_name(f"{output.stem}.samples.png")
    for path in (output, pictures) if checkpoint else (output,):
        options.require_output(path, ".png", overwrite)
    histories = [read_log(path) for path in chosen.logs]
    samples, scale = [], ""
    if checkpoint and chosen.data:
        from .train.data import DataSelection, load

        network, config = load_network(named_checkpoint(checkpoint))
        selection = DataSelection(
            chosen.data,
            chosen.split_file,
            crop_share=config.crop_share,
            background=config.background,
            part="test",
        )
        training = load(selection)
        samples = sample_predictions(network, training, config.frame, chosen.count)
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
