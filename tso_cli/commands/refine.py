"""`tso refine`: parse, call, print."""

from __future__ import annotations

import sys
import time
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from ..errors import GateError, InputError
from ..io.reading import require_memory
from ..optimisation.presets import MODES, PRESETS
from . import options

PATH = options.FilePath()
BYTES_A_MOVING_POINT = 1100
# At most with an unsure camera: half of those are off by over 15 degrees (`tso lab pose`).
UNSURE_CONFIDENCE = 0.49
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


@click.command("refine", cls=options.Command, headings=HEADINGS, brief=BRIEF)
@click.argument("source", type=PATH)
@click.argument("masks", metavar="[MASK]...", nargs=-1, type=PATH)
@click.option(
    "--mode",
    type=click.Choice(MODES),
    default="points",
    help="What is optimised: the points, the network's encoder, all its weights, or its latent code.",
)
@click.option(
    "--preset",
    type=click.Choice(PRESETS),
    default="best",
    help="Loss and defaults of the options below: the most accurate on validation shapes, or those of the paper.",
)
@click.option(
    "--budget",
    metavar="auto|full|SECONDS",
    default="auto",
    help="What the scene is known to gain by; 96 steps a mask, for 0 to 3 %; or at most so many seconds for the steps.",
)
@click.option(
    "--points",
    type=options.AutoOrInteger(),
    metavar="auto|N",
    help="How many points move by themselves, 16 to 16,384 (of a mesh 4,096); the others follow.  [default: auto: 1024, with a "
    "short budget 512; paper all]",
)
@click.option(
    "--symmetry",
    metavar="auto|none|x|y|z|a,b,c,d",
    help="Mirror plane of the object: detected, none, normal to an axis of the cloud through its middle, or ax+by+cz=d.  "
    "[default: auto; paper and network modes none]",
)
@click.option(
    "--steps",
    type=click.IntRange(min=0),
    help="Optimiser steps; 0 writes the start.  "
    "[default: 48 a mask, up to four, or twice that where several large ones fit badly; encoder modes 12, latent 30; paper 50]",
)
@click.option(
    "--learning-rate",
    type=float,
    help="[default: 4e-2 points, 3e-5 encoder, 6e-5 encoder-decoder, 1e-3 latent; paper 5e-4, 1e-6, 5e-6, 1e-3]",
)
@click.option(
    "--gamma",
    type=float,
    help="Weight of the Chamfer distance to the start.  [default: 0; paper 1e6, encoder 0]",
)
@click.option(
    "--sigma-sq",
    type=float,
    help="Variance of the projector's Gaussian, squared 64ths of the object's window; for --preset paper and "
    "--refine-camera.  [default: 0.4]",
)
@click.option(
    "--checkpoint",
    type=PATH,
    help="File of tso train, or `default`, the shipped network.  [default: default]",
)
@click.option(
    "--frame",
    type=click.Choice(["view", "world"]),
    help="Axes of the output of a view-aligned network: the camera's, or the world's.  [default: view]",
)
@click.option(
    "--place",
    type=click.Choice(["silhouette", "box", "camera"]),
    help="How a view-aligned network's cloud is placed: so that its silhouette, or its box, fits the mask; or at t of the "
    "camera file, as an object of longest side 1 around the origin.  [default: silhouette]",
)
@click.option(
    "--camera",
    type=options.CameraPath(),
    help="Camera file, for several masks with a view of each; or `fit`: estimated from one mask and the cloud.  "
    "[default: MASKSTEM.camera.json, else camera.json or cameras.json beside the mask, else canonical]",
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
    metavar="NAME",
    help="What the input is, if not as tso expects: camera-to-world, opengl, cloud-z-up, cloud-millimetres, mask-flipped, ...; "
    "warnings name the likely one, an unknown NAME lists all; NAME@MASK for one mask of several.",
)
@click.option("--invert-mask", is_flag=True, help="The object is dark in the mask.")
@click.option(
    "--ignore",
    type=PATH,
    multiple=True,
    help="Image whose bright pixels are unknown: left out of the loss.",
)
@click.option(
    "--depth",
    type=PATH,
    multiple=True,
    help="Depth map along the camera's z, 16-bit PNG or .npy; 0, NaN: unknown.",
)
@click.option(
    "--depth-scale",
    type=click.FloatRange(min=0.0, min_open=True),
    help="Size of one step of the depth map in units of the camera; 0.001 for millimetres and metres.  [default: 1]",
)
@click.option(
    "--image",
    type=PATH,
    multiple=True,
    help="Photo of the mask, for a photometric loss on a cloud with colours.",
)
@click.option(
    "-o", "--output", type=PATH, help="Refined cloud, .ply.  [default: SOURCESTEM.refined.ply here]"
)
@options.overwrite
@click.option(
    "--accept-doubtful",
    is_flag=True,
    help="Take the whole step also where it is doubtful, not a part or nothing.",
)
@click.option(
    "--strict",
    is_flag=True,
    help="Write nothing where the result is doubtful, or not judged; exit code 3.",
)
@click.option(
    "--overlay", type=PATH, help="Picture of mask, silhouette and cloud before and after, .png."
)
@click.option(
    "--check", is_flag=True, help="Only print the camera, the scale and the overlap with the mask."
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
    tso refine --mode points CLOUD MASK
    tso refine --mode points CLOUD MASK MASK ... --camera FILE
    tso refine --mode points CLOUD --camera FILE
    tso refine --mode encoder IMAGE MASK [--checkpoint FILE]
    tso refine --mode encoder-decoder IMAGE MASK [--checkpoint FILE]

    The views of the camera file belong to the masks that they name, else to the masks in their order. Without any MASK, all
    masks that the file names are used.

    The output is the input file with other coordinates: order, precision, colours, faces and all other attributes stay. Of a
    large cloud, or of the surface of a mesh, 1,024 points are refined, and all others follow.
    """
    started = time.perf_counter()
    if quiet and verbose:
        raise InputError("--quiet and --verbose, expected one of the two")
    warned = ctx.with_resource(options.collected_warnings(quiet))
    with options.loading():
        from ..diagnosis.hypotheses import mirrored
        from .refine_check import check_scene
        from .refine_files import RefineInputs, RefineOutputs
    inputs = options.pick(RefineInputs, chosen)
    refine_camera, write_camera = chosen["refine_camera"], chosen["write_camera"]
    for name, used in (
        ("--camera fit", inputs.fit),
        ("--refine-camera", refine_camera),
        ("--write-camera", write_camera),
    ):
        if used and inputs.mode != "points":
            raise InputError(
                f"{name} is for --mode points, found --mode {inputs.mode}, which places its cloud before the camera itself"
            )
    chosen["output"] = chosen["output"] or Path(f"{inputs.source.stem}.refined.ply")
    outputs = options.pick(RefineOutputs, chosen)
    if not check:
        outputs.check(inputs.files)
    scene = inputs.load()
    if verbose or (check and not quiet):
        if inputs.checkpoint is not None:
            options.log(f"tso: checkpoint: {inputs.checkpoint}")
        options.log(f"tso: camera: {', '.join(dict.fromkeys(scene.camera_sources))}")
    with options.loading():
        from ..refinement import RefineConfig, refine
    if chosen["sigma_sq"] is None:
        chosen["sigma_sq"] = scene.sigma_sq
    elif inputs.preset == "best" and not refine_camera:
        warnings.warn(
            "--sigma-sq is of the paper's projection, which the preset best does not use",
            stacklevel=1,
        )
    config = options.pick(RefineConfig, chosen)
    if strict and not config.settings().staged:
        found = f"--mode {config.mode} --preset {config.preset}"
        raise InputError(
            f"--strict is for results that are judged, of --mode points --preset best, found {found}"
        )
    if check:
        doubt = check_scene(scene, config, as_json, quiet, warned)
        if doubt and strict:
            raise GateError(f"{inputs.source}: is doubtful: {doubt}")
        return
    if write_camera and any(map(mirrored, scene.views)):
        raise InputError(
            f"--write-camera {write_camera}: the cloud has left-handed axes, which no camera has; found --assume "
            f"{' '.join(inputs.assume)}, expected a cloud with right-handed axes"
        )
    read = time.perf_counter() - started
    with options.loading():
        from .refine_report import RefineReport
    if scene.start and config.settings().points is None:
        require_memory(inputs.source, BYTES_A_MOVING_POINT * len(scene.start.given))
    bar = options.ProgressBar("tso: refining")

    def on_progress(step: int, total: int, loss: float) -> None:
        bar(step, total, f"steps, loss {loss:.6g}" if verbose else "steps")

    try:
        with options.naming(inputs.source):
            result = refine(
                scene.start,
                scene.views,
                config=config,
                network=scene.network,
                image=scene.image,
                progress=on_progress if sys.stderr.isatty() and not quiet else None,
            )
    finally:
        bar.close()
    if scene.doubt:
        confidence = result.confidence and min(result.confidence, UNSURE_CONFIDENCE)
        reason = result.reason if result.suspects else scene.doubt
        result = replace(result, verdict="doubtful", confidence=confidence, reason=reason)
    writing = time.perf_counter()
    refused = strict and result.verdict in ("doubtful", None)
    if not refused:
        outputs.write(result, scene, inputs.masks)
    finished = time.perf_counter()
    seconds = {
        "read": read,
        **result.seconds,
        "write": finished - writing,
        "total": finished - started,
    }
    for text in result.warnings:
        warnings.warn(text, stacklevel=1)
    report = RefineReport(
        result, scene, inputs, outputs, refine_camera, config.parsed_budget, seconds
    )
    if as_json:
        options.echo_json(report.document(warned, written=not refused))
    if refused:
        verdict = "doubtful" if result.verdict else "not judged"
        raise GateError(
            f"{inputs.source}: the result is {verdict}: {result.reason}; with --strict nothing is written"
        )
    if not as_json and not quiet:
        report.print_summary()
        if verbose:
            report.print_details()
    if result.stop_reason == "interrupted":
        ctx.exit(130)
