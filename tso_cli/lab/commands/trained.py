"""What the studies that train networks share on the command line."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar

import click

from ...commands import options
from .records import Reporter, answer, check_outputs, earlier_record, keep, resume, so_far

Function = TypeVar("Function", bound=Callable[..., Any])


def training_options(function: Function) -> Function:
    """The options of every study that trains networks."""
    for option in reversed(
        [
            click.option(
                "--meshes",
                type=options.FilePath(),
                required=True,
                help="Folder with CATEGORY/NAME for every name of the split.",
            ),
            click.option("--split", "split_file", type=options.FilePath(), help="[default: that of the shipped network]"),
            click.option(
                "--part",
                type=click.Choice(["test", "validation"]),
                default="test",
                show_default=True,
                help="List of the split to judge on; training takes the list train.",
            ),
            click.option(
                "--category", "categories", multiple=True, help="May be repeated.  [default: those of the paper's study]"
            ),
            click.option(
                "--full",
                is_flag=True,
                help="At the paper's rate, 5e-5: 20,000 steps of 16 on all shapes, without what makes few steps go further.",
            ),
            click.option("--steps", type=click.IntRange(min=1), help="Of every network.  [default: reduced, see above]"),
            click.option("--batch-size", type=click.IntRange(min=1), help="[default: 8; 16 with --full]"),
            click.option(
                "--limit", type=click.IntRange(min=1), help="Training shapes a category.  [default: 32; all with --full]"
            ),
            click.option(
                "--frame",
                type=click.Choice(["canonical", "view"]),
                default="canonical",
                show_default=True,
                help="Axes of the predicted points: the objects' own, as in the paper, or the camera's.",
            ),
            answer,
            resume("after every network, and every 500 steps within one"),
            options.device,
            options.seed,
            options.overwrite,
            options.as_json,
        ]
    ):
        function = option(function)
    return function


def run(
    study: ModuleType,
    draw: Callable[..., None],
    table: Callable[[dict[str, Any]], str],
    measure: Callable[..., dict[str, Any]] | None = None,
    *,
    meshes: Path,
    split_file: Path | None,
    part: str,
    categories: tuple[str, ...],
    full: bool,
    steps: int | None,
    batch_size: int | None,
    limit: int | None,
    frame: str,
    output: Path | None,
    resume: bool,
    device: str,
    seed: int,
    overwrite: bool,
    as_json: bool,
) -> None:
    """Run a study of `tso_cli.lab.studies`, with its own ``settings`` and ``conclude``; print its table and its claims."""
    check_outputs(output, overwrite, resume)
    from ..studies.material import Source
    from ..studies.parts import SPLIT
    from ..studies.trained import Budget, Keeping, forget, study_networks

    changes: dict[str, Any] = {"seed": seed, "device": device, "frame": frame}
    changes |= {name: value for name, value in (("steps", steps), ("batch_size", batch_size)) if value is not None}
    budget = Budget.full(**changes) if full else Budget(**{"steps": study.STEPS, **changes})
    if limit is None and not full:
        limit = 32
    chosen = tuple(dict.fromkeys(categories)) or (study.FULL if full else study.REDUCED)
    source = Source(meshes, split_file or SPLIT, part, chosen, limit, seed)
    unfinished = output.with_name(f"{output.stem}.unfinished.safetensors") if output else None
    earlier = earlier_record(study.NAME, output, resume)
    if earlier is None:
        forget(unfinished)
    keeping = Keeping(earlier, so_far(output), unfinished)
    record = study_networks(study.NAME, source, budget, study.settings(chosen), study.conclude, measure, keeping, Reporter())
    keep(record, output, draw, overwrite or resume)
    if as_json:
        options.echo_json(record)
        return
    click.echo(table(record))
    click.echo(_explained(record))
    for claim in record["claims"]:
        click.echo(f"{'holds' if claim['holds'] else 'does not hold'}: {claim['claim']} ({claim['found']})")


def _explained(record: dict[str, Any]) -> str:
    settings = record["settings"]
    shapes = ", ".join(
        f"{name} {count['training']} to train and {count['judged']} to judge" for name, count in settings["shapes"].items()
    )
    return (
        f"{settings['steps']} steps of {settings['batch_size']} at a rate of {settings['learning_rate']:g}, seed "
        f"{settings['seed']}, {settings['frame']} frame, {settings['device']}; shapes: {shapes} ({settings['part']}), "
        f"{settings['judged_views']} views each\n"
        "Chamfer x1000: squared distances, mean over points, both directions summed, each cloud scaled by its own box (the "
        "paper's protocol); absolute values do not compare between data sets"
    )
