"""What `tso train` prints when it is done."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ..version import __version__

if TYPE_CHECKING:
    from ..train import TrainConfig, TrainResult
    from ..train.data import TrainingData


def result_document(
    result: TrainResult, config: TrainConfig, output: Path, training: TrainingData, on_examples: bool
) -> dict[str, Any]:
    """The JSON document, but for its times; judges the network.

    Parameters
    ----------
    on_examples : trained on the shipped meshes: then it is judged on the shipped pictures too.
    """
    from ..train import evaluate
    from ..train.sources import shipped_examples
    from ..train.state import state_path

    def judged(data: TrainingData) -> dict[str, float | int]:
        forward, backward, shapes = evaluate(result.network, data, config.frame)
        return {"forward": forward, "backward": backward, "chamfer": forward + backward, "shapes": shapes}

    last = result.history[-100:].mean(0)
    document: dict[str, Any] = {
        "output": output,
        "state": state_path(output),
        "stop_reason": result.stop_reason,
        "steps": result.steps,
        "loss": float(last[0]),
        "lambda_dropped_at": result.lambda_dropped_at,
        "training_set": training.description,
    }
    found = judged(training)
    # Masks may be all there is to learn from.
    if found["shapes"]:
        document["chamfer_training"] = found
    document["objects"], document["not_judged"] = len(training.objects), dict(training.not_judged)
    if on_examples:
        document["chamfer_unseen_examples"] = judged(shipped_examples(training.crop_share, training.background))
    document |= {
        "convention": f"squared distances, mean over points, {training.scale}; forward is target -> prediction",
        "scale": training.scale,
        "supervision": config.supervision,
        "frame": config.frame,
        "points": config.points,
        "sigma_sq": config.sigma_sq,
        "learning_rate": config.learning_rate,
        "batch_size": config.batch_size,
        "device": config.device,
        "seed": config.seed,
        "version": __version__,
    }
    return document


def print_result(document: dict[str, Any]) -> None:
    """For people."""
    seconds = document["seconds"]
    click.echo(f"{document['output']}: {document['steps']} steps in {seconds['train']:.0f} s, {document['training_set']}")
    for key, label in (("chamfer_training", "training shapes"), ("chamfer_unseen_examples", "unseen examples")):
        if key in document:
            values = {name: 1000.0 * document[key][name] for name in ("forward", "backward", "chamfer")}
            click.echo(
                f"Chamfer x1000, {document[key]['shapes']} {label}: {values['chamfer']:.2f} "
                f"(forward {values['forward']:.2f}, backward {values['backward']:.2f})"
            )
    if document["not_judged"]:
        click.echo(
            f"{len(document['not_judged'])} of {document['objects']} objects have no 3D file to judge by (--json names them)"
        )
    speed = document["images_per_second"]
    click.echo(
        f"{speed['training']:.0f} images/s in training; a step without the optimiser {speed['step']:.0f}, the bare network's "
        f"forward and backward {speed['bare']:.0f}: data, projector and losses add {round(100.0 * speed['added'])} %"
    )
    click.echo(
        f"(squared distances, mean over points, {document['scale']}; N {document['points']}, seed {document['seed']}, "
        f"sigma^2 {document['sigma_sq']:g}, {document['device']})"
    )
