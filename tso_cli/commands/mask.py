"""`tso mask`: what a mask file shows, as tso reads it."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path

import click

from ..errors import InputError
from ..option import check, opt
from ..version import __version__
from . import options


@dataclass(frozen=True, kw_only=True)
class MaskOptions:
    """What `tso mask` may be given.

    output : Picture of the mask to write, .png.
    invert : The object is dark in the mask.
    """

    file: Path = opt(options.REQUIRED, role="argument")
    output: Path | None = opt(None, names=("-o", "output"))
    overwrite: bool = options.overwrite()
    label: str | None = options.label()
    mask_index: int | None = options.mask_index()
    invert: bool = opt(False, names=("invert_mask",))
    as_json: bool = options.as_json()

    def __post_init__(self) -> None:
        check(self)


@options.command("mask", MaskOptions)
def command(ctx: click.Context, chosen: MaskOptions) -> None:
    """Show what would be used of the mask in FILE: its size, its foreground, and its box.

    FILE is a picture, an image of labels, an array (.npy, .npz, .pt) or an annotation (.json, .xml,
    .txt) of COCO, SAM, labelme, CVAT, VIA, Label Studio, YOLO or Cityscapes. With -o the mask is
    written as a grey picture.
    """
    import numpy as np

    from ..geometry.view import object_box
    from ..io.images import orientation, write_image
    from ..io.masks import MaskChoice, read_mask

    file, output = chosen.file, chosen.output
    if output is not None:
        options.require_output(output, ".png", chosen.overwrite)
        if output.resolve() == file.resolve():
            raise InputError(f"{output}: is the input, expected another name")
    with options.Warnings(False):
        mask = read_mask(file, MaskChoice(chosen.label, chosen.mask_index))
        if chosen.invert:
            mask = np.float32(1.0) - mask
        inside = mask > 0.5
        if inside.all() or not inside.any():
            what = "everything" if inside.any() else "nothing"
            warnings.warn(
                f"{file}: {what} is inside, which tso refine refuses; expected a part of the "
                "picture",
                stacklevel=1,
            )
    height, width = mask.shape
    turned = orientation(file)
    pixels = int(np.count_nonzero(inside))
    soft = int(np.count_nonzero((mask > 0.0) & (mask < 1.0)))
    box = object_box(inside) if pixels else None
    if output is not None:
        write_image(output, np.rint(mask * 255.0).astype(np.uint8), chosen.overwrite)
    if chosen.as_json:
        options.echo_json({
            "file": file, "width": width, "height": height, "foreground": pixels, "soft": soft,
            "box": box, "exif_orientation": turned, "output": output, "version": __version__,
        })  # fmt: skip
        return
    click.echo(f"{file}: {width}x{height}, {pixels:,} px inside ({pixels / mask.size:.1%})")
    if box:
        left, top, right, bottom = box
        click.echo(f"  object    columns {left} to {right - 1}, rows {top} to {bottom - 1}")
    if soft:
        click.echo(f"  soft      {soft:,} px between 0 and 1")
    if turned != 1:
        # From 5 on, the picture is turned by a quarter.
        sides = (height, width) if turned >= 5 else (width, height)
        click.echo(
            f"  turned    upright, by EXIF orientation {turned}; stored as {sides[0]}x{sides[1]}, "
            "and tso refine with a camera file takes it as stored"
        )
    if output is not None:
        click.echo(f"{output}: picture")
