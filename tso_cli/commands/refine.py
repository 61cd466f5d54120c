"""`tso refine`: parse, call, print."""

from __future__ import annotations

import sys
import time
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ..errors import GateError, InputError
from ..io.reading import require_memory
from ..optimisation.presets import MODES, PRESETS
from . import options

if TYPE_CHECKING:
    from ..refinement import RefineConfig, RefineResult
    from ..scene.load import Scene
    from .refine_files import RefineInputs, RefineOutputs
    from .sentences import Words

PATH = options.FilePath()
# Memory of one control point.
BYTES_OF_A_CONTROL_POINT = 1100
HEADINGS = {
    "mode": "Method",
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
    "budget",
    "camera",
    "output",
    "overwrite",
    "overlay",
    "check",
    "strict",
    "as_json",
)


def _hypotheses() -> dict[str, str]:
    """The table that `--assume list` prints."""
    from ..diagnosis.hypotheses import HYPOTHESES

    return {name: hypothesis.says for name, hypothesis in HYPOTHESES.items()}


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
    "--budget",
    metavar="auto|SECONDS",
    default="auto",
    help="How much work to spend: `auto` (from the scene), or a limit in seconds.",
)
@click.option(
    "--points",
    type=options.AutoOrInteger(),
    metavar="auto|N",
    help="How many control points move by themselves, 16 to 16,384 (of a mesh at most 4,096); all "
    "other points follow.  [default: auto: 1024, or 512 with a short budget; paper: all]",
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
    metavar="N",
    help="Optimiser steps; 0 writes the start.  [default: 48 for each mask, up to four masks; "
    "encoder modes 12, latent 30; paper 50]",
)
@click.option(
    "--learning-rate",
    type=float,
    metavar="X",
    help="[default: 4e-2 points, 3e-5 encoder, 6e-5 encoder-decoder, 1e-3 latent; paper 5e-4, "
    "1e-6, 5e-6, 1e-3]",
)
@click.option(
    "--gamma",
    type=float,
    metavar="X",
    help="Weight of the Chamfer distance to the start.  [default: 0; paper 1e6, encoder 0]",
)
@click.option(
    "--sigma-sq",
    type=float,
    metavar="X",
    help="Variance of the projector's Gaussian, in squared 64ths of the object's window. "
    "--preset paper and --refine-camera use it.  [default: 0.4]",
)
@click.option(
    "--checkpoint",
    type=PATH,
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
    type=options.CameraPath(),
    help="Camera file (JSON), with a view for each mask. `fit` estimates the camera of a single "
    "mask.  [default: MASKSTEM.camera.json, camera.json or cameras.json next to the mask, else a "
    "canonical camera]",
)
@click.option(
    "--refine-camera",
    is_flag=True,
    help="First correct the cameras, close to the given ones; points mode.",
)
@click.option("--write-camera", type=PATH, help="Write the fitted or refined cameras, .json.")
@click.option(
    "--assume",
    multiple=True,
    is_eager=True,
    callback=options.listing(_hypotheses),
    metavar="NAME",
    help="How the input is meant, if not as tso expects, e.g. camera-to-world or cloud-z-up; "
    "NAME@MASK for one mask of several. Warnings name the likely one; `--assume list` lists all.",
)
@click.option("--invert-mask", is_flag=True, help="The object is dark in the mask.")
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
    metavar="X",
    help="Size of one step of the depth map in units of the camera; 0.001 for millimetres and "
    "metres.  [default: 1]",
)
@click.option(
    "--image",
    type=PATH,
    multiple=True,
    help="Photo of the mask, for a photometric loss on a cloud with colours.",
)
@click.option(
    "-o",
    "--output",
    type=PATH,
    help="Refined cloud, .ply.  [default: SOURCESTEM.refined.ply in the current folder]",
)
@options.overwrite
@click.option(
    "--accept-doubtful",
    is_flag=True,
    help="Take the whole displacement even if the result is doubtful.",
)
@click.option(
    "--strict",
    is_flag=True,
    help="Write nothing if the result is doubtful or has no confidence; exit code 3.",
)
@click.option(
    "--overlay",
    type=PATH,
    help="Picture of mask, silhouette and cloud before and after, .png.",
)
@click.option(
    "--check",
    is_flag=True,
    help="Only examine the input: print the camera, the scale, the overlap with the mask, and what "
    "may be wrong.",
)
@click.option(
    "-q", "--quiet", is_flag=True, help="Print nothing but errors and the document of --json."
)
@click.option(
    "-v", "--verbose", is_flag=True, help="Also print all measures and settings, for each view."
)
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

    The views of the camera file belong to the masks that they name, else to the masks in their
    order. Without any MASK, all masks that the file names are used.

    The output is the input file with other coordinates: order, precision, colours, faces and all
    other attributes stay. A large cloud, or the surface of a mesh, moves by 1,024 control points;
    all other points follow.
    """
    started = time.perf_counter()
    if quiet and verbose:
        raise InputError("--quiet and --verbose, expected one of the two")
    warned = ctx.with_resource(options.Warnings(quiet)).texts
    with options.loading():
        from .refine_files import RefineInputs, RefineOutputs
    inputs = options.pick(RefineInputs, chosen)
    chosen["output"] = chosen["output"] or Path(f"{inputs.source.stem}.refined.ply")
    outputs = options.pick(RefineOutputs, chosen)
    _require_points_mode(inputs, chosen)
    if not check:
        outputs.check(inputs.files)
    scene = inputs.load()
    if verbose or (check and not quiet):
        _log_sources(inputs, scene)
    with options.loading():
        from .refine_check import check_scene
        from .sentences import Words
    config = _config(inputs, scene, chosen, strict)
    settings = config.settings(len(scene.views))
    words = Words([view.name for view in scene.views], inputs.invert_mask)
    if check:
        reason = check_scene(scene, settings, words, as_json, quiet, warned)
        if reason and strict:
            raise GateError(f"{inputs.source}: is doubtful: {reason}")
        return
    _require_writable_cameras(inputs, outputs, scene)
    read = time.perf_counter() - started
    if settings.points is None and inputs.mode == "points":
        require_memory(inputs.source, BYTES_OF_A_CONTROL_POINT * len(scene.points))
    result = _refined(inputs, scene, config, words, quiet, verbose)
    writing = time.perf_counter()
    refused = strict and result.trust.verdict in ("doubtful", None)
    if not refused:
        outputs.write(result, scene, inputs.masks)
    finished = time.perf_counter()
    times = {"write": finished - writing, "total": finished - started}
    for text in words.warnings(result):
        warnings.warn(text, stacklevel=1)
    from .refine_report import RefineReport

    seconds = {"read": read, **result.cost.seconds, **times}
    corrected = chosen["refine_camera"]
    budget = "auto" if config.budget == "auto" else config.budget_seconds
    report = RefineReport(result, scene, inputs, outputs, words, corrected, budget, seconds)
    if as_json:
        options.echo_json(report.document(warned, written=not refused))
    if refused:
        verdict = result.trust.verdict or "without confidence"
        raise GateError(
            f"{inputs.source}: the result is {verdict}: {words.reason(result)}; with --strict "
            "nothing is written"
        )
    if not as_json and not quiet:
        report.print_summary()
        if verbose:
            report.print_details()
    if result.fit.stop_reason == "interrupted":
        ctx.exit(130)


def _require_points_mode(inputs: RefineInputs, chosen: dict[str, Any]) -> None:
    """Refuse options about cameras in the network modes."""
    for name in ("refine_camera", "write_camera"):
        if chosen[name] and inputs.mode != "points":
            raise InputError(
                f"--{name.replace('_', '-')} is for --mode points, found --mode {inputs.mode}, "
                "which places its cloud before the camera itself"
            )


def _log_sources(inputs: RefineInputs, scene: Scene) -> None:
    if inputs.checkpoint is not None:
        options.log(f"tso: checkpoint: {inputs.checkpoint}")
    options.log(f"tso: camera: {', '.join(dict.fromkeys(scene.camera_sources))}")


def _config(
    inputs: RefineInputs, scene: Scene, chosen: dict[str, Any], strict: bool
) -> RefineConfig:
    with options.loading():
        from ..refinement import RefineConfig
    if chosen["sigma_sq"] is None:
        chosen["sigma_sq"] = scene.sigma_sq
    elif inputs.preset == "best" and not chosen["refine_camera"]:
        warnings.warn(
            "--sigma-sq is of the paper's projection, which the preset best does not use",
            stacklevel=1,
        )
    config = options.pick(RefineConfig, chosen)
    if strict and not config.settings().staged:
        raise InputError(
            "--strict is for results with a confidence, of --mode points --preset best, found "
            f"--mode {config.mode} --preset {config.preset}"
        )
    return config


def _require_writable_cameras(inputs: RefineInputs, outputs: RefineOutputs, scene: Scene) -> None:
    """Refuse to write the cameras of a cloud with left-handed axes."""
    from ..diagnosis.hypotheses import left_handed

    if outputs.write_camera and left_handed(scene.given.assumptions):
        raise InputError(
            f"--write-camera {outputs.write_camera}: the cloud has left-handed axes, which no "
            f"camera has; found --assume {' '.join(inputs.assume)}, expected a cloud with "
            "right-handed axes"
        )


def _refined(
    inputs: RefineInputs,
    scene: Scene,
    config: RefineConfig,
    words: Words,
    quiet: bool,
    verbose: bool,
) -> RefineResult:
    """The result, with a progress bar on a terminal."""
    from ..diagnosis.examine import NoOverlapError
    from ..refinement import refine

    bar = options.ProgressBar("tso: refining")

    def on_progress(step: int, total: int, loss: float) -> None:
        bar(step, total, f"steps, loss {loss:.6g}" if verbose else "steps")

    given = scene.given
    try:
        with options.naming(inputs.source):
            return refine(
                given.cloud if inputs.mode == "points" else None,
                given.read,
                config=config,
                assume=given.assumptions,
                network=scene.network,
                image=scene.image,
                known=given.known,
                progress=on_progress if sys.stderr.isatty() and not quiet else None,
            )
    except NoOverlapError as error:
        raise words.no_overlap(error) from None
    finally:
        bar.close()
