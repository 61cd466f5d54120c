"""`tso export`: a copy of a network at half the size."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import click

from ..errors import InputError
from ..io.shipped import CATEGORIES, examples_folder
from ..option import opt
from ..version import __version__
from . import options


@dataclass(frozen=True, kw_only=True)
class ExportOptions:
    """What `tso export` may be given.

    output : Copy to write (.safetensors).
    """

    checkpoint: Path = opt(options.REQUIRED, role="argument")
    output: Path = opt(options.REQUIRED, names=("-o", "output"))
    overwrite: bool = options.overwrite()
    as_json: bool = options.as_json()


@options.command("export", ExportOptions)
def command(ctx: click.Context, chosen: ExportOptions) -> None:
    """Write a copy of CHECKPOINT with 16-bit weights and without the state of its training.

    The copy is used like any checkpoint, but a training cannot be resumed from it. The command
    prints how far predicted points move because of the smaller weights, measured on the shipped
    examples.
    """
    checkpoint, output, overwrite = chosen.checkpoint, chosen.output, chosen.overwrite
    options.require_output(output, ".safetensors", overwrite)
    import torch

    from ..io.checkpoints import load_network, save_network

    network, config = load_network(checkpoint)
    if output.exists() and output.samefile(checkpoint):
        raise InputError(f"{output}: is the input, expected another name for the copy")
    examples = [examples_folder() / name for name in CATEGORIES]
    save_network(output, network, config, overwrite, torch.float16)
    moved = max(_largest_change(folder, checkpoint, output) for folder in examples)
    before, after = checkpoint.stat().st_size, output.stat().st_size
    if chosen.as_json:
        convention = "largest distance that a predicted point moves, shapes of longest side about 1"
        sizes = {"output": output, "bytes_before": before, "bytes_after": after}
        options.echo_json(
            sizes | {"largest_change": moved, "convention": convention, "version": __version__}
        )
        return
    click.echo(f"{output}: {before / 1e6:.1f} MB -> {after / 1e6:.1f} MB")
    click.echo(
        f"  moved  {moved:.2g} of a shape's longest side at most "
        f"(predicted points of {', '.join(CATEGORIES)})"
    )


def _largest_change(folder: Path, *checkpoints: Path) -> float:
    """The largest distance between corresponding points that the two checkpoints predict."""
    import numpy as np
    import torch

    from ..io.checkpoints import load_network
    from ..io.images import read_image
    from ..io.views import ViewFiles, load_views
    from ..network.input import network_input

    (view,), _ = load_views(ViewFiles([folder / "mask.png"]))
    clouds = []
    for network, config in map(load_network, checkpoints):
        image = read_image(folder / "image.png")
        inputs = network_input(image, view, config.image_size, config.crop_share, config.background)
        with torch.no_grad():
            clouds.append(network(torch.from_numpy(inputs.image)[None])[0].double().numpy())
    return float(np.linalg.norm(clouds[0] - clouds[1], axis=1).max())
