"""What `tso train` reports when it is done."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from ...train.config import TrainConfig
from ...train.data import TrainingData
from ...train.loop import TrainResult, evaluate
from ...train.sources import shipped_examples
from ...train.trainer import state_path
from ...version import __version__

FROM_CONFIG = (
    "supervision", "frame", "points", "sigma_sq", "learning_rate", "batch_size", "device", "seed",
)  # fmt: skip


def training_document(
    result: TrainResult,
    config: TrainConfig,
    output: Path,
    training: TrainingData,
    on_examples: bool,
) -> dict[str, Any]:
    """Evaluate the network: the JSON document, without times and failures.

    With ``on_examples`` the network is evaluated on the shipped pictures too.
    """

    def measure(data: TrainingData) -> dict[str, float | int]:
        forward, backward, shapes = evaluate(result.network, data, config.frame)
        return {
            "forward": forward,
            "backward": backward,
            "chamfer": forward + backward,
            "shapes": shapes,
        }

    document = {
        "output": output,
        "state": state_path(output),
        "stop_reason": result.stop_reason,
        "steps": result.steps,
        "loss": float(result.history[-100:].mean(0)[0]),
        "lambda_dropped_at": result.lambda_dropped_at,
        "training_set": training.description,
    }
    # A data set for supervision by masks may have no 3D file at all.
    if (chamfer := measure(training))["shapes"]:
        document["chamfer_training"] = chamfer
    document["objects"] = len(training.objects)
    document["not_judged"] = dict(training.not_evaluated)
    if on_examples:
        document["chamfer_unseen_examples"] = measure(
            shipped_examples(training.crop_share, training.background)
        )
    return document | {
        "convention": f"squared distances, mean over points, {training.scale}; "
        "forward is target -> prediction",
        "scale": training.scale,
        **{name: getattr(config, name) for name in FROM_CONFIG},
        "version": __version__,
    }


def unusable(sets: list[TrainingData]) -> dict[str, str]:
    """Each picture that could not be used -> the reason."""
    backgrounds = sets[0].backgrounds.unusable if sets[0].backgrounds else {}
    return {item: why for data in sets for item, why in data.unusable.items()} | backgrounds


def print_summary(document: dict[str, Any]) -> None:
    """Print the document for people."""
    click.echo(
        f"{document['output']}: {document['steps']} steps in {document['seconds']['train']:.0f} s, "
        f"{document['images_per_second']:.0f} images/s, "
        f"{document['training_set']}"
    )
    for key, label in (
        ("chamfer_training", "training shapes"),
        ("chamfer_unseen_examples", "unseen examples"),
    ):
        if key in document:
            forward, backward, chamfer = (
                1000.0 * document[key][name] for name in ("forward", "backward", "chamfer")
            )
            click.echo(
                f"Chamfer x1000, {document[key]['shapes']} {label}: {chamfer:.2f} "
                f"(forward {forward:.2f}, backward {backward:.2f})"
            )
    if document["not_judged"]:
        click.echo(
            f"{len(document['not_judged'])} of {document['objects']} objects have no 3D file "
            "and were not evaluated (--json names them)"
        )
    click.echo(
        f"(squared distances, mean over points, {document['scale']}; N {document['points']}, "
        f"seed {document['seed']}, sigma^2 {document['sigma_sq']:g}, {document['device']})"
    )
