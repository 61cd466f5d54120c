"""`tso refine`: its options; `RefineRun` does the work."""

from __future__ import annotations

from pathlib import Path
from typing import Any, get_args

import click

from ..errors import InputError
from ..geometry.depth_kind import DepthKind
from ..optimisation.presets import MODES, PRESETS
from ..pose.asked import ASKED, KEEPS
from . import options

PATH = options.PATH
HEADINGS = {
    "mode": "Method",
    "move": "What moves as one first (points mode)",
    "checkpoint": "Network modes",
    "camera": "Camera",
    "invert_mask": "Further input, one image for each mask or none",
    "output": "Output",
    "device": "Running",
}
# What --help shows; --help-all shows every option.
BRIEF = (
    "mode",
    "preset",
    "move",
    "camera",
    "output",
    "overwrite",
    "overlay",
    "report",
    "check",
    "strict",
    "as_json",
)


def _hypotheses() -> dict[str, str]:
    """The table that `--assume list` prints."""
    from ..diagnosis.hypotheses import HYPOTHESES, of_width

    example = of_width(518)
    return {one.name: one.says for one in (*HYPOTHESES.values(), example)}


def _config(ctx: click.Context, parameter: click.Parameter, path: Path | None) -> None:
    if path is not None and not ctx.resilient_parsing:
        from .refine_record import read_config

        read_config(ctx, path)


@click.command("refine", cls=options.Command, headings=HEADINGS, brief=BRIEF)
@click.argument("source", type=PATH)
@click.argument("masks", metavar="[MASK]...", nargs=-1, type=PATH)
@click.option(
    "--mode",
    type=click.Choice(MODES),
    default="points",
    help="What is optimised: the points, the network's encoder, all of its weights, or its latent "
    "code.",
)
@click.option(
    "--preset",
    type=click.Choice(PRESETS),
    default="best",
    help="Loss and defaults: the most accurate on validation shapes, or the paper's.",
)
@click.option(
    "--prior",
    type=options.FilePath(*options.WORDS["prior"]),
    metavar="learned|none|FILE",
    help="The network that first moves the cloud to a likely shape: the shipped one, none, or a "
    "file of tso train --prior.  [default: learned; paper and network modes: none]",
)
@click.option(
    "--points",
    type=options.AutoOrInteger(),
    metavar="auto|N",
    help="How many control points move by themselves, 16 to 16,384 (of a mesh at most 4,096); all "
    "other points follow.  [default: auto: 1024; paper: all]",
)
@click.option(
    "--symmetry",
    metavar="auto|none|x|y|z|a,b,c,d",
    help="Mirror plane of the object: detected, none, normal to an axis of the cloud through its "
    "middle, or ax+by+cz=d.  [default: auto; paper and network modes: none]",
)
@click.option(
    "--steps",
    type=options.Whole(0),
    help="Optimiser steps; 0 leaves the shape.  [default: 20; encoder modes 12, latent 30; "
    "paper 50]",
)
@click.option(
    "--learning-rate",
    type=float,
    help="[default: 4e-3 points, 3e-5 encoder, 6e-5 encoder-decoder, 1e-3 latent; paper 5e-4, "
    "1e-6, 5e-6, 1e-3]",
)
@click.option(
    "--gamma",
    type=float,
    help="Weight of the Chamfer distance to the start, with --preset paper.  [default: 1e6, "
    "encoder 0]",
)
@click.option(
    "--sigma-sq",
    type=float,
    help="Variance of the projector's Gaussian, in squared 64ths of the object's window, with "
    "--preset paper.  [default: 0.4]",
)
@click.option(
    "--move",
    type=click.Choice(ASKED),
    metavar="WHAT",
    help="What moves as one first: auto, shape (nothing), pose, similarity or camera.  [default: "
    "auto]",
)
@options.flag("--refine-camera", "The same as --move camera.", "refine_camera")
@click.option(
    "--keep",
    type=click.Choice(KEEPS),
    default="auto",
    help="What stays where one camera cannot tell size from distance. `auto`: the size for a pose, "
    "the distance for a similarity and for --move auto.",
)
@options.flag("--only", "Only move as one, and leave the shape as it is.")
@click.option(
    "--write-transform",
    type=PATH,
    help="Write the 4x4 matrix that the cloud moved by as one, .json.",
)
@click.option(
    "--checkpoint",
    type=options.FilePath(*options.WORDS["checkpoint"]),
    help="File of tso train, or `default`, the shipped network.  [default: default]",
)
@click.option(
    "--frame",
    type=click.Choice(["view", "world"]),
    help="Axes of the output of a view-aligned network: the camera's, or the world's.  "
    "[default: view]",
)
@click.option(
    "--place",
    type=click.Choice(["silhouette", "box", "camera"]),
    help="How the cloud of a view-aligned network is placed: its silhouette, or its box, fits the "
    "mask; or it stands at t of the camera file, as an object of longest side 1 around the "
    "origin.  [default: silhouette]",
)
@click.option(
    "--camera",
    type=options.FilePath(*options.WORDS["camera"]),
    help="Camera file or folder of any program, or `fit` to estimate it.  [default: a file next to "
    "the mask, else a canonical camera]",
)
@options.camera_format
@click.option(
    "--intrinsics",
    type=PATH,
    help="Camera file whose K is used: with a --camera that holds poses alone, or with --camera "
    "fit.",
)
@click.option(
    "--focal",
    type=float,
    help="The focal length in pixels of the mask: with --camera fit, or with a --camera that holds "
    "poses alone.  [default: with fit that of the EXIF data of the photo, else unknown]",
)
@click.option("--fov", type=float, help="The same as horizontal field of view, degrees.")
@click.option(
    "--pose-index",
    type=options.Whole(0),
    help="With --camera fit: which of the poses that were found is used, as --json lists them; 0 "
    "is the best.  [default: 0]",
)
@options.object_id
@click.option("--write-camera", type=PATH, help="Write the fitted or moved cameras, .json.")
@click.option(
    "--assume",
    multiple=True,
    is_eager=True,
    callback=options.listing(_hypotheses),
    metavar="NAME",
    help="How the input is meant, if not as tso expects, e.g. camera-to-world or cloud-z-up; "
    "NAME@MASK for one mask of several. Warnings name the likely one; `--assume list` lists all.",
)
@options.flag("--invert-mask", "The object is dark in the mask.")
@options.label
@options.mask_index
@click.option(
    "--mask-error",
    type=float,
    metavar="PX",
    help="How exactly the masks show where the outline is, a standard deviation in pixels.  "
    "[default: by their softness and size, at least 0.5]",
)
@click.option(
    "--ignore",
    type=PATH,
    multiple=True,
    help="Image whose bright pixels are unknown: the loss leaves them out.",
)
@click.option(
    "--depth",
    type=PATH,
    multiple=True,
    help="Depth map along the camera's z axis, 16-bit PNG or .npy; 0 and NaN are unknown.",
)
@click.option(
    "--depth-scale",
    type=float,
    help="Size of one step of the depth map in units of the camera; 0.001 for millimetres and "
    "metres.  [default: 1]",
)
@click.option(
    "--depth-kind",
    type=click.Choice(get_args(DepthKind)),
    default="auto",
    help="What the depth map holds: depth along z; inverse (disparity) or affine depth, up to "
    "scale and shift; or distance along the ray. `auto`: along z, and ignored if the cloud shows "
    "another kind.",
)
@click.option(
    "--image",
    type=PATH,
    multiple=True,
    help="Photo of the mask. With --camera fit it decides between poses of a cloud with colours. "
    "Otherwise --report, --overlay and --rerun only show it.",
)
@options.output(
    "Refined cloud.  [default: SOURCESTEM.refined.ply, or .glb, .gltf or .obj as the input, in the "
    "current folder]"
)
@options.overwrite
@options.flag(
    "--crop",
    "Write the object alone, without points far from the rest or that most masks leave out.",
)
@options.flag(
    "--point-confidence",
    "Write how far the masks determine each point, 0 to 1, as `confidence` of the .ply.",
)
@options.flag("--accept-doubtful", "Move the points even where a doubtful cloud would be left.")
@options.flag(
    "--strict",
    "Write nothing if the result is doubtful or has no confidence: exit code 3. Exit code 4 if "
    "the cloud is left.",
)
@click.option(
    "--overlay",
    type=PATH,
    help="Picture of mask, silhouette and cloud before and after, .png.",
)
@click.option("--report", type=PATH, help="Interactive page of the result, .html.")
@click.option(
    "--rerun",
    type=PATH,
    help="Recording of the optimisation for the viewer rerun, .rrd.",
)
@options.flag(
    "--record",
    "Write NAME.record.json next to the result: inputs, settings, findings.",
)
@click.option(
    "--config",
    type=PATH,
    is_eager=True,
    expose_value=False,
    callback=_config,
    help="Options from a file, unless they are given here: a record of --record, or TOML or JSON.",
)
@options.flag(
    "--check",
    "Only print camera, scale, the overlap with the mask, and what may be wrong.",
)
@options.flag("-q", "Print nothing but errors and the document of --json.", "--quiet")
@options.flag("-v", "Also print all measures and settings, for each view.", "--verbose")
@options.as_json
@options.device
@click.pass_context
def command(
    ctx: click.Context,
    check: bool,
    strict: bool,
    quiet: bool,
    verbose: bool,
    as_json: bool,
    **chosen: Any,
) -> None:
    """Make a point cloud agree with masks and write the refined cloud.

    \b
    tso refine CLOUD MASK
    tso refine CLOUD MASK MASK ... --camera FILE
    tso refine CLOUD --camera FILE
    tso refine --mode MODE IMAGE MASK [--checkpoint FILE]

    A mask gets the view whose picture has its name, else views and masks are taken in their order.
    Without any MASK, all masks that the file names are used.

    A .ply, .glb, .gltf or .obj file comes out with other coordinates; all other attributes stay. A
    large cloud, or the surface of a mesh, moves by 1,024 control points; all other points follow.
    """
    if quiet and verbose:
        raise InputError("--quiet and --verbose, expected one of the two")
    warned = ctx.with_resource(options.Warnings(quiet)).texts
    with options.loading():
        from .refine_run import RefineRun
    if options.CONFIG in ctx.meta:
        from .refine_record import warn_of_changes

        warn_of_changes(ctx)
    given = options.given(ctx)
    run = RefineRun(chosen, given, warned, check, strict, quiet, verbose, as_json)
    ctx.exit(run.check() if check else run.refine())
