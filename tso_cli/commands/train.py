"""`tso train`: parse, call, print."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ..errors import InputError
from . import options
from .train_result import print_result, result_document
from .training_data import Wanted, load

if TYPE_CHECKING:
    from ..train import TrainConfig, TrainResult
    from ..train.data import TrainingData
    from ..train.processes import Processes
    from ..train.state import TrainingState

# Without DATA: about two minutes on two cores, at a rate that gets somewhere in so few steps (both by measurement).
EXAMPLE_STEPS, EXAMPLE_RATE, EXAMPLE_AVERAGING = 600, 3e-4, 0.99
STEPS, PAPER_RATE = 20_000, 5e-5


class CategoryValue(click.ParamType):
    """``airplane=0.1``."""

    name = "category=value"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[str, float]:
        category, _, number = str(value).partition("=")
        try:
            return category, float(number)
        except ValueError:
            self.fail(f"{value!r} is no category and number, expected such as airplane=0.1", param, ctx)


@click.command("train", short_help="Train the network that predicts a cloud from a photo.")
@click.argument("data", required=False, type=options.FilePath())
@click.option("--split", "split_file", type=options.FilePath(), help='Train on the objects of its list "train" alone.')
@click.option("--category", "categories", multiple=True, help="Train on this category; may be repeated.  [default: all]")
@click.option("--strict", is_flag=True, help="Stop at what cannot be used instead of leaving it out.")
@click.option(
    "-o", "--output", type=options.FilePath(), default=Path("base.safetensors"), show_default=True, help="Checkpoint to write."
)
@click.option(
    "--supervision",
    type=click.Choice(["points", "masks", "joint"]),
    default="points",
    show_default=True,
    help="Chamfer to the true points, masks through the projector, or both at once (--mask-data).",
)
@click.option("--mask-data", type=options.FilePath(), help="Images that have one mask each, for --supervision joint.")
@click.option("--mask-split", type=options.FilePath(), help='Of --mask-data take the list "train" of this split alone.')
@click.option(
    "--mask-category",
    "mask_categories",
    multiple=True,
    help="Of --mask-data take this category; may be repeated.  [default: all]",
)
@click.option(
    "--init",
    "initial",
    type=options.FilePath(),
    help='Start from the weights of this checkpoint; "default" is the shipped one.  [default: random weights]',
)
@click.option(
    "--frame",
    type=click.Choice(["view", "canonical"]),
    default="view",
    show_default=True,
    help="Axes of the predicted points: the camera's, or the objects' own.",
)
@click.option(
    "--views", type=int, default=4, show_default=True, help="Masks that supervise each object a step, of --supervision masks."
)
@click.option("--steps", type=int, help=f"Adam steps in all.  [default: {STEPS}; {EXAMPLE_STEPS} without DATA]")
@click.option("--batch-size", type=int, default=16, show_default=True, help="Objects a step.")
@click.option("--learning-rate", type=float, help=f"Of Adam.  [default: {PAPER_RATE:g}; {EXAMPLE_RATE:g} without DATA]")
@click.option(
    "--lambda",
    "affinity_weight",
    type=float,
    default=1.0,
    show_default=True,
    help="Weight of the affinity loss, 0.02 of it once the loss saturates.",
)
@click.option(
    "--affinity", type=click.Choice(["points", "paper"]), default="points", show_default=True, help="Form of the affinity loss."
)
@click.option(
    "--saturation-steps",
    type=int,
    help="Lambda drops once the mean loss over so many steps is not 1 % below that of as many before.  [default: a sixth of "
    "--steps, 10 to 500]",
)
@click.option(
    "--sigma-sq",
    type=float,
    default=0.4,
    show_default=True,
    help="Variance of the projection's Gaussian, px^2 of the 64x64 mask.",
)
@click.option(
    "--category-sigma-sq",
    multiple=True,
    metavar="CATEGORY=VALUE",
    type=CategoryValue(),
    help="The same for one category; may be repeated.",
)
@click.option("--points", type=int, default=1024, show_default=True, help="Points of the predicted cloud.")
@click.option(
    "--crop-share",
    type=float,
    default=0.9,
    show_default=True,
    help="Share of the input's side that the object takes up, whatever its size; clouds have longest side 1. 0: the input "
    "keeps sizes, and so do the clouds.",
)
@click.option(
    "--background",
    type=click.Choice(["black", "white", "keep"]),
    default="black",
    show_default=True,
    help="What stands around the object in the input.",
)
@click.option(
    "--backgrounds",
    "behind",
    metavar="FOLDER|textures",
    help="Put the objects of DATA on crops of these photos, or on generated textures; with --background keep.",
)
@click.option("--balance", is_flag=True, help="Every category equally often, however many objects it has.")
@click.option("--augment", is_flag=True, help="Mirror and recolour the pictures at random.")
@click.option(
    "--averaging",
    type=float,
    help="Save the running mean of the weights, which keeps this share of itself a step; 0: the last weights."
    f"  [default: 0; {EXAMPLE_AVERAGING:g} without DATA]",
)
@click.option(
    "--precision",
    type=click.Choice(["float32", "bfloat16"]),
    default="float32",
    show_default=True,
    help="bfloat16: mixed precision, for GPUs and processors that have it.",
)
@click.option("--workers", type=int, default=1, show_default=True, help="Threads that prepare batches ahead.")
@options.seed
@options.device
@click.option(
    "--checkpoint-every",
    type=click.IntRange(min=0),
    default=500,
    show_default=True,
    help="Steps between checkpoints; 0: only at the end.",
)
@click.option("--resume", is_flag=True, help="Go on from the state beside the checkpoint.")
@options.overwrite
@click.option("--log-file", type=options.FilePath(), help="Settings and losses of every step, .jsonl.")
@options.as_json
@click.pass_context
def command(
    ctx: click.Context,
    data: Path | None,
    split_file: Path | None,
    categories: tuple[str, ...],
    strict: bool,
    mask_data: Path | None,
    mask_split: Path | None,
    mask_categories: tuple[str, ...],
    initial: Path | None,
    output: Path,
    steps: int | None,
    learning_rate: float | None,
    averaging: float | None,
    crop_share: float,
    background: str,
    behind: str | None,
    category_sigma_sq: tuple[tuple[str, float], ...],
    device: str,
    checkpoint_every: int,
    resume: bool,
    overwrite: bool,
    log_file: Path | None,
    as_json: bool,
    **settings: Any,
) -> None:
    """Train the network that predicts a cloud from a photo, for `tso refine --mode encoder` and `encoder-decoder`.

    DATA is a folder that `tso render` wrote, or ShapeNet, 3D-R2N2 or Pix3D as they are distributed. Without it the shipped
    example meshes are rendered and trained on for about two minutes. The state of the training lies beside the checkpoint
    (NAME.training.safetensors) for --resume; Ctrl-C finishes the step at hand and writes both. Several processes:
    torchrun --nproc-per-node N -m tso_cli train ...
    """
    from ..train import TrainConfig
    from ..train.processes import joined
    from ..train.state import stored_window

    if resume and settings["saturation_steps"] is None:
        settings["saturation_steps"] = stored_window(output)
    started = time.perf_counter()
    with joined(device) as (processes, device):
        config = TrainConfig(
            steps=steps if steps is not None else STEPS if data else EXAMPLE_STEPS,
            learning_rate=learning_rate if learning_rate is not None else PAPER_RATE if data else EXAMPLE_RATE,
            averaging=averaging if averaging is not None else 0.0 if data else EXAMPLE_AVERAGING,
            device=device,
            category_sigma_sq=dict(category_sigma_sq),
            **settings,
        )
        if (config.supervision == "joint") != (mask_data is not None):
            expected = "--mask-data FOLDER with it" if mask_data is None else "joint with --mask-data"
            raise InputError(f"--supervision is {config.supervision}, expected {expected}")
        _refuse_unused(ctx, config.supervision)
        if processes.first:
            _check_outputs(output, log_file, resume, overwrite)
        processes.wait()
        points = config.supervision != "masks"
        wanted = Wanted(data, split_file, categories, strict, crop_share, background, behind, points=points)
        training = load(wanted, quiet=not processes.first)
        of_masks = Wanted(mask_data, mask_split, mask_categories, strict, crop_share, background)
        masked = load(of_masks, quiet=not processes.first) if mask_data else None
        state = _begin(training, config, output, initial, resume, quiet=not processes.first)
        prepared, begun = time.perf_counter(), state.step
        result = _run(training, masked, config, state, processes, output, log_file, checkpoint_every)
    if not processes.first:
        return
    trained = time.perf_counter()
    document = result_document(result, config, output, training, data is None)
    document["seconds"] = {"prepare": prepared - started, "train": trained - prepared, "judge": time.perf_counter() - trained}
    from ..train.speed import images_per_second

    document["images_per_second"] = {
        "training": (result.steps - begun) * config.batch_size / (trained - prepared),
        **images_per_second(state, config, training, masked),
    }
    both = [training, masked] if masked else [training]
    unusable = {item: why for own in both for item, why in own.unusable.items()}
    if training.backgrounds:
        unusable |= training.backgrounds.unusable
    if unusable:
        options.log(f"tso: {len(unusable)} pictures could not be used and were left out (--strict stops at the first)")
    document["left_out"] = {item: why for own in both for item, why in own.skipped.items()} | unusable
    if as_json:
        options.echo_json(document)
    else:
        print_result(document)
    if result.stop_reason == "interrupted":
        options.log(
            f"tso: interrupted after {result.steps} of {config.steps} steps; {output} and its state were written. "
            "Run the same command with --resume to go on"
        )
        ctx.exit(130)


def _begin(
    training: TrainingData, config: TrainConfig, output: Path, initial: Path | None, resume: bool, quiet: bool
) -> TrainingState:
    """The state to go on from: that beside the checkpoint, or a new one."""
    from .. import device as devices
    from ..io.checkpoints import load_network
    from ..io.shipped import named_checkpoint
    from ..train import network_config, start
    from ..train.state import load_training

    if resume:
        if initial is not None:
            raise InputError("--init with --resume: the state to resume has weights of its own, expected one of the two")
        described = network_config(training, config, 0)
        state = load_training(output, described, training.fingerprint(), devices.resolve(config.device))
        if not quiet:
            options.log(f"tso: resuming after {state.step} steps")
        return state
    return start(training, config, load_network(named_checkpoint(initial))[0] if initial else None)


def _run(
    training: TrainingData,
    masked: TrainingData | None,
    config: TrainConfig,
    state: TrainingState,
    processes: Processes,
    output: Path,
    log_file: Path | None,
    save_every: int,
) -> TrainResult:
    from ..train import train
    from ..train.state import save_training, write_history

    def save(current: TrainingState, current_config: Any) -> None:
        save_training(output, current, current_config)
        if log_file is not None:
            write_history(log_file, current.history, current_config)

    return train(
        training,
        config,
        state,
        masked=masked,
        processes=processes,
        progress=options.ProgressBar("train"),
        save=save,
        save_every=save_every,
    )


def _refuse_unused(ctx: click.Context, supervision: str) -> None:
    """Options that the supervision has no use for, if they were given."""
    of = {
        "views": ("masks",),
        **dict.fromkeys(("affinity_weight", "affinity", "saturation_steps", "category_sigma_sq"), ("masks", "joint")),
    }
    of |= dict.fromkeys(("mask_split", "mask_categories"), ("joint",))
    for option in ctx.command.params:
        kinds = of.get(option.name or "")
        given = ctx.get_parameter_source(option.name or "") is click.core.ParameterSource.COMMANDLINE
        if kinds and given and supervision not in kinds:
            raise InputError(f"{option.opts[0]} is for --supervision {' or '.join(kinds)}, found {supervision}")


def _check_outputs(output: Path, log_file: Path | None, resume: bool, overwrite: bool) -> None:
    from ..io.output import check_output

    if output.suffix != ".safetensors":
        raise InputError(f"{output}: ends in {output.suffix or 'nothing'!r}, expected a checkpoint name in .safetensors")
    # What a resumed run replaces is its own.
    state = output.with_name(f"{output.stem}.training.safetensors")
    for path in (output, state):
        check_output(path, overwrite or resume)
    if log_file is not None:
        check_output(log_file, overwrite or resume)
        if log_file.resolve() in (output.resolve(), state.resolve()):
            raise InputError(f"--log-file {log_file}: is the checkpoint or its state, expected a file of its own")
