"""`tso lab lambda`."""

from __future__ import annotations

from typing import Any

import click

from .trained import run, training_options


@click.command("lambda")
@training_options
def command(**arguments: Any) -> None:
    """lambda, the weight of the affinity loss, in both of its forms.

    Reduced size: chairs, 500 steps of 8.
    """
    from ..charts.training_charts import draw_weight
    from ..studies import weight

    run(weight, draw_weight, _table, **arguments)


def _table(record: dict[str, Any]) -> str:
    from ...plots.table import text_table

    summary, paper = record["summary"], record["paper"]
    weights = list(next(iter(summary.values())))
    rows: list[list[Any]] = [[f"form {form!r}", *own.values()] for form, own in summary.items()]
    rows += [[f"paper ({name})", *(own.get(weight) for weight in weights)] for name, own in paper.items()]
    return text_table(["lambda", *weights], rows, decimals=2)
