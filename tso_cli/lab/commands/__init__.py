"""`tso lab`: a command for each question."""

from __future__ import annotations

import click

from ...commands.lazy_group import LazyGroup

SECTIONS = {
    "Studies": {
        "accuracy": (
            "tso_cli.lab.commands.accuracy",
            "How much nearer to the truth a refinement comes, and how often further away.",
        ),
        "evidence": (
            "tso_cli.lab.commands.evidence",
            "Other evidence than one right mask: depth, wrong views and cameras, truncated objects.",
        ),
        "tso": (
            "tso_cli.lab.commands.variants",
            "The paper's table of test-stage optimisation: encoder, encoder and decoder, points.",
        ),
        "examples": ("tso_cli.lab.commands.examples", "The shipped examples, one by one."),
        "points": ("tso_cli.lab.commands.points", "The points variant with settings of your choice."),
        "pose": ("tso_cli.lab.commands.pose", "How well a camera is found from mask and cloud alone."),
        "network": ("tso_cli.lab.commands.network", "The base network on unseen shapes."),
        "supervision": ("tso_cli.lab.commands.supervision", "What a network learns from: points, masks, other projections."),
        "views": ("tso_cli.lab.commands.views", "How many masks of each object supervise a step."),
        "lambda": ("tso_cli.lab.commands.weight", "lambda, the weight of the affinity loss."),
        "affinity": ("tso_cli.lab.commands.affinity", "Does the affinity loss remove outliers?"),
        "sigma": ("tso_cli.lab.commands.sigma", "How wide should the Gaussian be?"),
        "failures": ("tso_cli.lab.commands.failures", "The paper's two failures: narrow aeroplanes, cars deformed in depth."),
        "departures": ("tso_cli.lab.commands.departures", "Where training departs from the paper, and what that changes."),
    },
    "Tools": {
        "fingerprint": ("tso_cli.lab.commands.fingerprint", "Whether records are of the method as it is."),
        "generate": ("tso_cli.lab.commands.generate", "Draw chairs, cars and aeroplanes by rule, to train on."),
    },
}


@click.group("lab", cls=LazyGroup, sections=SECTIONS)
def command() -> None:
    """Ask a question of the method, on many shapes, and keep the answer as JSON beside a chart."""
