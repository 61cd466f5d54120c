"""`tso refine`: parse, call, print."""

from __future__ import annotations

import sys
import time
import warnings
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

import click

from ..errors import InputError
from ..io.output import atomic_output, check_output
from ..io.shipped import DEFAULT, named_checkpoint
from . import options
from .refine_camera import camera_records, refuse_camera_options, refuse_camera_output, write_used_cameras
from .refine_result import document, print_check
from .refine_summary import print_details, print_result

if TYPE_CHECKING:
    from ..scene.network import Placing

MODES = ("points", "encoder", "encoder-decoder", "latent")


@click.command("refine")
@click.argument("source", type=options.FilePath())
@click.argument("masks", metavar="[MASK]...", nargs=-1, type=options.FilePath())
@click.option("--mode", type=click.Choice(MODES), default="points", show_default=True, help="What moves.")
@click.option(
    "--checkpoint",
    type=options.FilePath(),
    help="Network of the encoder modes: a file of tso train, or `default`, the shipped one.  [default: default]",
)
@click.option(
    "--camera",
    "camera_file",
    type=options.CameraPath(),
    help="Camera file, of several masks their views; or `fit`: found from the one mask and the cloud.  "
    "[default: MASKSTEM.camera.json, else camera.json or cameras.json beside the mask, else canonical]",
)
@click.option("--refine-camera", is_flag=True, help="Correct the cameras first, held near the given ones.")
@click.option("--write-camera", type=options.FilePath(), help="Camera file of the fitted or refined cameras, .json.")
@click.option("-o", "--output", type=options.FilePath(), help="Refined cloud, .ply.  [default: SOURCESTEM.refined.ply here]")
@options.overwrite
@click.option("--invert-mask", is_flag=True, help="The object is what is dark in the mask.")
@click.option(
    "--ignore",
    "ignore_files",
    type=options.FilePath(),
    multiple=True,
    help="Image whose bright pixels say nothing of the object; once for each mask, or not at all.",
)
@click.option(
    "--depth",
    "depth_files",
    type=options.FilePath(),
    multiple=True,
    help="Depth map along the camera's z, 16-bit PNG or .npy, 0 or NaN where unknown; once for each mask, or not at all.",
)
@click.option(
    "--depth-scale",
    type=click.FloatRange(min=0.0, min_open=True),
    help="Units of the camera to a step of the depth map; 0.001 for millimetres beside metres.  [default: 1]",
)
@click.option(
    "--image",
    "image_files",
    type=options.FilePath(),
    multiple=True,
    help="Photo that the mask is of, for the colours of a cloud that has them; once for each mask, or not at all.",
)
@click.option(
    "--frame",
    type=click.Choice(["view", "world"]),
    help="Axes of the cloud that a view-aligned network gives.  [default: view]",
)
@click.option(
    "--place",
    "place_by",
    type=click.Choice(["silhouette", "box", "camera"]),
    help="Where a view-aligned network's cloud stands: where its silhouette, or its box, fills the mask; or where the camera "
    "file has an object of longest side 1 around the origin.  [default: silhouette]",
)
@click.option(
    "--preset",
    type=click.Choice(["best", "paper"]),
    default="best",
    show_default=True,
    help="What is optimised, and the defaults below.",
)
@click.option(
    "--symmetry",
    metavar="auto|none|x|y|z|a,b,c,d",
    help="Mirror plane of the object: found, none, an axis of the cloud normal to a plane through its middle, or ax+by+cz=d.  "
    "[default: auto; paper and encoder modes none]",
)
@click.option(
    "--steps",
    type=click.IntRange(min=0),
    help="Steps; 0 writes the start.  [default: 48 points for each mask, up to four, 12 encoder modes, 30 latent; paper 50]",
)
@click.option(
    "--learning-rate",
    type=float,
    help="[default: 4e-2 points, 3e-5 encoder, 6e-5 encoder-decoder, 1e-3 latent; paper 5e-4, 1e-6, 5e-6]",
)
@click.option(
    "--gamma",
    type=float,
    help="Weight of the Chamfer distance to the start.  [default: 0; paper 1e6, encoder 0]",
)
@click.option(
    "--sigma-sq",
    type=float,
    help="Variance of the projection's Gaussian, squared 64ths of the object's window; for --preset paper, --refine-camera.  "
    "[default: 0.4]",
)
@options.device
@options.seed
@click.option("--overlay", type=options.FilePath(), help="Picture of mask, silhouette and cloud before and after, .png.")
@click.option("--check", is_flag=True, help="Say which camera, scale and overlap, and stop there.")
@click.option("-q", "--quiet", is_flag=True, help="Print errors alone, and the document of --json.")
@click.option("-v", "--verbose", is_flag=True, help="Print every measure and setting too, view by view.")
@options.as_json
@click.pass_context
def command(
    ctx: click.Context,
    source: Path,
    masks: tuple[Path, ...],
    mode: str,
    checkpoint: Path | None,
    camera_file: Path | None,
    refine_camera: bool,
    write_camera: Path | None,
    output: Path | None,
    overwrite: bool,
    invert_mask: bool,
    ignore_files: tuple[Path, ...],
    depth_files: tuple[Path, ...],
    depth_scale: float | None,
    image_files: tuple[Path, ...],
    frame: str | None,
    place_by: Placing | None,
    preset: str,
    symmetry: str | None,
    steps: int | None,
    learning_rate: float | None,
    gamma: float | None,
    sigma_sq: float | None,
    device: str,
    seed: int,
    overlay: Path | None,
    check: bool,
    quiet: bool,
    verbose: bool,
    as_json: bool,
) -> None:
    """Make a point cloud agree with masks and write the refined cloud.

    \b
    tso refine --mode points CLOUD MASK
    tso refine --mode points CLOUD MASK MASK ... --camera FILE
    tso refine --mode points CLOUD --camera FILE
    tso refine --mode encoder IMAGE MASK [--checkpoint FILE]
    tso refine --mode encoder-decoder IMAGE MASK [--checkpoint FILE]

    Several masks belong to the views of the camera file that name them, else to its views in their order; without any MASK, all
    that the file names are used.

    The cloud that comes out is the file that went in with other coordinates: order, precision, colours, faces and every
    other attribute stay. Where the file has faces, 1,024 points spread over them are moved, and its vertices follow. The result
    does not depend on the seed, which is only recorded.
    """
    started = time.perf_counter()
    if quiet and verbose:
        raise InputError("--quiet and --verbose, expected one of the two")
    warned = ctx.with_resource(options.collected_warnings(quiet))
    _refuse_mixed_up(mode, source, masks, ignore_files, checkpoint, frame, place_by)
    fit = camera_file == options.FIT
    _refuse_evidence(mode, preset, fit, depth_files, depth_scale, image_files)
    refuse_camera_options(mode, fit, refine_camera, write_camera)
    if fit:
        camera_file = None
    network = None
    if mode != "points":
        network = "shipped network" if checkpoint in (None, Path(DEFAULT)) else f"network {checkpoint}"
        checkpoint = named_checkpoint(checkpoint or Path(DEFAULT))
    if not masks:
        masks = _masks_of(camera_file)
    output = output or Path(f"{source.stem}.refined.ply")
    if not check:
        inputs = (source, *masks, camera_file, *ignore_files, *depth_files, *image_files)
        _refuse_outputs(output, overlay, overwrite, inputs)
        refuse_camera_output(write_camera, overwrite, (*inputs, output, overlay))
    with options.loading():
        from ..refinement.placement import mask_doubts, place, require_overlap
        from ..scene.load import load_points_scene

    if checkpoint is None:
        scene = load_points_scene(
            source, masks, camera_file, invert_mask, ignore_files, fit, depth_files, depth_scale or 1.0, image_files
        )
    else:
        from ..scene.network import load_network_scene

        ignore_file = ignore_files[0] if ignore_files else None
        scene = load_network_scene(
            source, masks[0], checkpoint, camera_file, invert_mask, ignore_file, frame == "world", place_by or "silhouette"
        )
    # Of a result the camera is told with it.
    if verbose or (check and not quiet):
        if checkpoint is not None:
            options.log(f"tso: checkpoint: {checkpoint}")
        options.log(f"tso: camera: {scene.camera_source}")
    if check:
        placements = [place(scene.moving, view) for view in scene.views]
        for doubt in (doubt for view in scene.views for doubt in mask_doubts(view, len(scene.moving))):
            warnings.warn(doubt, stacklevel=1)
        if as_json or not quiet:
            print_check(scene, placements, as_json)
        for placement, view in zip(placements, scene.views, strict=True):
            require_overlap(placement, view)
        return
    read = time.perf_counter() - started
    with options.loading():
        from ..refinement import RefineConfig, refine

    if sigma_sq is not None and preset == "best" and not refine_camera:
        warnings.warn("--sigma-sq is of the paper's projection, which the preset best does not use", stacklevel=1)
    sigma_sq = scene.sigma_sq if sigma_sq is None else sigma_sq
    config = RefineConfig(mode, steps, learning_rate, gamma, sigma_sq, device, seed, preset, symmetry, refine_camera)
    bar = options.ProgressBar("tso: refining")

    def told(step: int, total: int, loss: float) -> None:
        bar(step, total, f"steps, loss {loss:.6g}" if verbose else "steps")

    try:
        result = refine(
            None if scene.network else scene.points,
            scene.views,
            config=config,
            network=scene.network,
            image=scene.image,
            colours=scene.colours,
            faces=scene.faces,
            progress=told if sys.stderr.isatty() and not quiet else None,
        )
    finally:
        bar.close()
    writing = time.perf_counter()
    from ..io.clouds import write_cloud

    # The picture takes its name only once the cloud is written: both are there in the end, or neither.
    with ExitStack() as outputs:
        if overlay is not None:
            from ..plots.overlay import draw_overlay

            draw_overlay(outputs.enter_context(atomic_output(overlay)), result, scene.views)
        if write_camera is not None:
            write_used_cameras(outputs.enter_context(atomic_output(write_camera)), result, masks)
        write_cloud(output, scene.to_output(result.points), like=scene.cloud, overwrite=overwrite)
    finished = time.perf_counter()
    seconds = {"read": read, **result.seconds, "write": finished - writing, "total": finished - started}
    for text in result.warnings:
        warnings.warn(text, stacklevel=1)
    if as_json:
        found = document(result, scene, checkpoint, output, overlay, preset, seconds, warned)
        options.echo_json(found | (camera_records(scene.views, result) if refine_camera else {}))
    elif not quiet:
        print_result(result, scene, network, refine_camera, output, seconds)
        for path, what in ((overlay, "picture"), (write_camera, "camera")):
            if path is not None:
                click.echo(f"{path}: {what}")
        if verbose:
            print_details(result, scene, refine_camera, seconds)
    if result.stop_reason == "interrupted":
        ctx.exit(130)


def _refuse_mixed_up(
    mode: str,
    source: Path,
    masks: tuple[Path, ...],
    ignore_files: tuple[Path, ...],
    checkpoint: Path | None,
    frame: str | None,
    place_by: str | None,
) -> None:
    if mode != "points":
        for name, count in (("MASK", len(masks)), ("--ignore", max(1, len(ignore_files)))):
            if count != 1:
                raise InputError(
                    f"--mode {mode} predicts a cloud from one photo, {name} was given {count} times, expected once"
                )
        return
    if checkpoint is not None:
        raise InputError(
            f"--mode points moves a cloud, found --checkpoint {checkpoint}; expected --mode encoder or encoder-decoder"
        )
    if source.suffix.lower() == ".safetensors":
        raise InputError(
            f"{source}: is a checkpoint, --mode points expects a cloud; to refine with a network: "
            "tso refine --mode encoder IMAGE MASK --checkpoint FILE"
        )
    if frame is not None:
        raise InputError("--frame is for the encoder modes; points mode keeps the frame of its cloud")
    if place_by is not None:
        raise InputError("--place is for the encoder modes; points mode takes its cloud to be where the camera file has it")


def _refuse_evidence(
    mode: str,
    preset: str,
    fit: bool,
    depth_files: tuple[Path, ...],
    depth_scale: float | None,
    image_files: tuple[Path, ...],
) -> None:
    for name, files in (("--depth", depth_files), ("--image", image_files)):
        if files and (mode, preset) != ("points", "best"):
            raise InputError(f"{name} is for --mode points --preset best, found --mode {mode} --preset {preset}")
    if depth_scale is not None and not depth_files:
        raise InputError(f"--depth-scale {depth_scale:g} says nothing without a depth map, expected --depth FILE")
    if depth_files and fit:
        raise InputError("--depth needs a camera whose distance is known, found --camera fit; expected a camera file")


def _masks_of(camera_file: Path | None) -> tuple[Path, ...]:
    """The masks that the camera file names, for want of others."""
    if camera_file is None:
        raise InputError("no MASK was given, expected one or more, or --camera FILE whose views name their masks")
    from ..io.pairing import named_masks

    return tuple(named_masks(camera_file))


def _refuse_outputs(output: Path, overlay: Path | None, overwrite: bool, inputs: tuple[Path | None, ...]) -> None:
    if output.suffix.lower() != ".ply":
        raise InputError(f"{output}: the suffix is {output.suffix!r}, expected .ply")
    check_output(output, overwrite)
    if overlay is not None:
        if overlay.suffix.lower() != ".png":
            raise InputError(f"{overlay}: the suffix is {overlay.suffix!r}, expected .png")
        check_output(overlay, overwrite)
        if any(path is not None and path.resolve() == overlay.resolve() for path in inputs):
            raise InputError(f"{overlay}: is an input, expected another name for --overlay")
