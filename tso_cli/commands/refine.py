"""`tso refine`: parse, call, print."""

from __future__ import annotations

import time
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from .. import __version__
from ..errors import InputError
from ..files.output import atomic_output, check_output
from ..files.shipped import DEFAULT, named_checkpoint
from . import options
from .refine_camera import (
    camera_records,
    print_cameras,
    refuse_camera_options,
    refuse_camera_output,
    write_used_cameras,
)

if TYPE_CHECKING:
    from ..camera import Camera
    from ..placement import Placement
    from ..refinement import RefineResult
    from ..scenes import Scene

MODES = ("points", "encoder", "encoder-decoder")


@click.command("refine")
@click.argument("source", type=options.FilePath())
@click.argument("mask", type=options.FilePath())
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
    help="Camera file, or `fit`: found from mask and cloud.  "
    "[default: MASKSTEM.camera.json, else camera.json or cameras.json beside the mask, else canonical]",
)
@click.option("--refine-camera", is_flag=True, help="Move the camera with the points, held near the given one.")
@click.option("--write-camera", type=options.FilePath(), help="Camera file of the fitted or refined camera, .json.")
@click.option("-o", "--output", type=options.FilePath(), help="Refined cloud, .ply.  [default: SOURCESTEM.refined.ply here]")
@options.overwrite
@click.option("--invert-mask", is_flag=True, help="The object is what is dark in the mask.")
@click.option("--ignore", "ignore_file", type=options.FilePath(), help="Image whose bright pixels say nothing of the object.")
@click.option(
    "--frame",
    type=click.Choice(["view", "world"]),
    help="Axes of the cloud that a view-aligned network gives.  [default: view]",
)
@click.option("--preset", type=click.Choice(["paper"]), default="paper", show_default=True, help="What the defaults below are.")
@click.option("--steps", type=click.IntRange(min=0), default=50, show_default=True, help="Adam steps; 0 writes the start.")
@click.option("--learning-rate", type=float, help="[default: 5e-4 points, 1e-6 encoder, 5e-6 encoder-decoder]")
@click.option("--gamma", type=float, help="Weight of the Chamfer distance to the start.  [default: 1e6; encoder 0]")
@click.option(
    "--sigma-sq",
    type=float,
    help="Gaussian's variance, px^2 of the mask (encoder modes: of the 64 px crop).  [default: 0.4 (max(W, H)/64)^2]",
)
@options.device
@options.seed
@click.option("--overlay", type=options.FilePath(), help="Picture of mask, silhouette and cloud before and after, .png.")
@click.option("--check", is_flag=True, help="Say which camera, scale and overlap, and stop there.")
@options.as_json
@click.pass_context
def command(
    ctx: click.Context,
    source: Path,
    mask: Path,
    mode: str,
    checkpoint: Path | None,
    camera_file: Path | None,
    refine_camera: bool,
    write_camera: Path | None,
    output: Path | None,
    overwrite: bool,
    invert_mask: bool,
    ignore_file: Path | None,
    frame: str | None,
    preset: str,
    steps: int,
    learning_rate: float | None,
    gamma: float | None,
    sigma_sq: float | None,
    device: str,
    seed: int,
    overlay: Path | None,
    check: bool,
    as_json: bool,
) -> None:
    """Make a point cloud agree with a mask and write the refined cloud.

    \b
    tso refine --mode points CLOUD MASK
    tso refine --mode encoder IMAGE MASK [--checkpoint FILE]
    tso refine --mode encoder-decoder IMAGE MASK [--checkpoint FILE]

    The cloud that comes out is the file that went in with other coordinates: order, precision, colours, faces and every
    other attribute stay. None of the three variants draws random numbers; the seed is only recorded.
    """
    started = time.perf_counter()
    _refuse_mixed_up(mode, source, checkpoint, frame)
    fit = camera_file == options.FIT
    refuse_camera_options(mode, fit, refine_camera, write_camera)
    if mode != "points":
        checkpoint = named_checkpoint(checkpoint or Path(DEFAULT))
    output = output or Path(f"{source.stem}.refined.ply")
    if not check:
        _refuse_outputs(output, overlay, overwrite, (source, mask, camera_file, ignore_file))
        refuse_camera_output(write_camera, overwrite, (source, mask, camera_file, ignore_file, output, overlay))
    from ..placement import place, require_overlap
    from ..scenes import load_network_scene, load_points_scene

    if checkpoint is None:
        scene = load_points_scene(source, mask, None if fit else camera_file, invert_mask, ignore_file, fit)
    else:
        scene = load_network_scene(source, mask, checkpoint, camera_file, invert_mask, ignore_file, frame == "world")
        options.log(f"tso: checkpoint: {checkpoint}")
    options.log(f"tso: camera: {scene.camera_source}")
    if check:
        placement = place(scene.points, scene.view)
        _print_check(scene, placement, as_json)
        require_overlap(placement, scene.view)
        return
    read = time.perf_counter() - started
    from ..refinement import RefineConfig, refine

    sigma_sq = scene.sigma_sq if sigma_sq is None else sigma_sq
    config = RefineConfig(mode, steps, learning_rate, gamma, sigma_sq, device, seed, refine_camera)
    bar = options.ProgressBar("tso: refining")
    result = refine(
        None if scene.network else scene.points,
        scene.view,
        config=config,
        network=scene.network,
        image=scene.image,
        progress=lambda step, total, loss: bar(step, total, f"loss {loss:.6g}"),
    )
    writing = time.perf_counter()
    from ..files.clouds import write_cloud

    # The picture takes its name only once the cloud is written: both are there in the end, or neither.
    with ExitStack() as outputs:
        if overlay is not None:
            from ..report.overlay import draw_overlay

            draw_overlay(outputs.enter_context(atomic_output(overlay)), result, scene.view)
        if write_camera is not None:
            write_used_cameras(outputs.enter_context(atomic_output(write_camera)), result, [mask])
        write_cloud(output, scene.to_output(result.points), like=scene.cloud, overwrite=overwrite)
    finished = time.perf_counter()
    seconds = {"read": read, **result.seconds, "write": finished - writing, "total": finished - started}
    if as_json:
        document = _document(result, scene, checkpoint, output, overlay, preset, seconds)
        options.echo_json(document | camera_records([scene.view], result))
    else:
        _print_result(result, output, overlay, seconds)
        print_cameras([scene.view], result, refine_camera, write_camera)
    if result.stop_reason == "non_finite":
        options.log(f"tso: warning: the loss was no number after step {result.steps}; the best before that was written")
    elif result.stop_reason == "interrupted":
        options.log(f"tso: interrupted at step {result.steps} of {steps}; the best so far was written")
        ctx.exit(130)


def _refuse_mixed_up(mode: str, source: Path, checkpoint: Path | None, frame: str | None) -> None:
    if mode != "points":
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


def _describe_camera(camera: Camera, source: str) -> dict[str, Any]:
    return {
        "source": source,
        "model": camera.model,
        "width": camera.width,
        "height": camera.height,
        "K": camera.K.tolist(),
        "R": camera.R.tolist(),
        "t": camera.t.tolist(),
    }


def _document(
    result: RefineResult,
    scene: Scene,
    checkpoint: Path | None,
    output: Path,
    overlay: Path | None,
    preset: str,
    seconds: dict[str, float],
) -> dict[str, Any]:
    return {
        "mode": result.mode,
        "preset": preset,
        "checkpoint": checkpoint,
        "output": output,
        "overlay": overlay,
        "camera": _describe_camera(scene.view.camera, scene.camera_source),
        "frame": scene.frame,
        "points": len(result.points),
        "steps": result.steps,
        "best_step": result.best_step,
        "stop_reason": result.stop_reason,
        "loss_before": result.loss_before,
        "loss_after": result.loss_after,
        "losses": result.losses,
        "iou_before": result.iou_before,
        "iou_after": result.iou_after,
        "chamfer_to_initial": result.chamfer_to_initial,
        "convention": {
            "chamfer_to_initial": "squared distances, mean over points, both directions summed, longest side 1",
            "iou": "silhouette > 0.5 against mask > 0.5, mean over views",
            "loss": "BCE summed over pixels x 64^2/(W H) + gamma x Chamfer to the initial cloud",
            "sigma_sq": "px^2 of the mask (encoder modes: mask, IoU and sigma_sq are those of the 64x64 crop)",
        },
        "learning_rate": result.learning_rate,
        "gamma": result.gamma,
        "sigma_sq": result.sigma_sq,
        "device": result.device,
        "seed": result.seed,
        "seconds": seconds,
        "version": __version__,
    }


def _print_result(result: RefineResult, output: Path, overlay: Path | None, seconds: dict[str, float]) -> None:
    click.echo(f"{output}: {len(result.points):,} points, {result.steps} steps, best at step {result.best_step}")
    click.echo(f"  IoU    {result.iou_before:.3f} -> {result.iou_after:.3f}   (silhouette > 0.5, mask > 0.5)")
    click.echo(
        f"  loss   {result.loss_before:.1f} -> {result.loss_after:.1f}   (BCE + {result.gamma:g} x Chamfer to the start)"
    )
    click.echo(
        f"  moved  {result.chamfer_to_initial * 1e3:.3f}   (Chamfer to the start x1000: squared, mean over points, "
        "both directions, longest side 1)"
    )
    click.echo(
        f"  sigma_sq {result.sigma_sq:g} px^2, learning rate {result.learning_rate:g}, {result.device}, seed {result.seed}, "
        f"{seconds['optimise']:.2f} s in the loop, {seconds['total']:.2f} s in all"
    )
    if overlay is not None:
        click.echo(f"{overlay}: picture")


def _print_check(scene: Scene, placement: Placement, as_json: bool) -> None:
    from ..placement import SMALLEST_BOX_IOU, describe_box

    camera = scene.view.camera
    size = scene.points.max(0) - scene.points.min(0)
    meets = placement.box_iou > SMALLEST_BOX_IOU
    if as_json:
        options.echo_json(
            {
                "camera": _describe_camera(camera, scene.camera_source),
                "frame": scene.frame,
                "extent": size.tolist(),
                "placement": placement.as_dict(),
                "meets": meets,
                "version": __version__,
            }
        )
        return
    K = camera.K
    click.echo(f"camera      {camera.model}, {camera.width}x{camera.height}, from {scene.camera_source}")
    click.echo(f"            f {K[0, 0]:.4g} x {K[1, 1]:.4g} px, principal point ({K[0, 2]:.4g}, {K[1, 2]:.4g})")
    click.echo(f"            R {camera.R.round(4).tolist()}, t {camera.t.round(4).tolist()}")
    click.echo(f"cloud       {placement.points:,} points, extent {size[0]:.4g} x {size[1]:.4g} x {size[2]:.4g}")
    if placement.depth is not None:
        click.echo(
            f"depth       {placement.depth[0]:.4g} to {placement.depth[1]:.4g}, {placement.behind:,} points behind the camera"
        )
    else:
        click.echo("depth       all points lie behind the camera")
    share = 100.0 / placement.points
    click.echo(
        f"points fall {placement.inside_image:,} inside the image ({placement.inside_image * share:.0f} %), "
        f"{placement.inside_mask:,} on the mask ({placement.inside_mask * share:.0f} %)"
    )
    click.echo(f"mask        {describe_box(placement.mask_box)}")
    if placement.points_box is not None:
        click.echo(f"silhouette  {describe_box(placement.points_box)}")
    verdict = "they meet" if meets else f"they do not meet (expected over {SMALLEST_BOX_IOU})"
    click.echo(f"boxes       IoU {placement.box_iou:.3f}: {verdict}")
