"""`tso lab views`."""

from __future__ import annotations

from typing import Any

import click

from .trained import run, training_options


@click.command("views")
@training_options
def command(**arguments: Any) -> None:
    """How many masks of each object supervise a step: 1, 2, 3, 4, 5, 6 and 8; of 1 and 2 three networks each.

    Reduced size: cars alone, 2,000 steps of 8.
    """
    from ..charts.training_charts import draw_views
    from ..studies import views

    run(views, draw_views, _table, **arguments)


def _table(record: dict[str, Any]) -> str:
    from ...plots.table import text_table

    summary = record["summary"]
    counts = list(next(iter(summary.values())))
    rows: list[list[Any]] = []
    for category, own in summary.items():
        rows.append([category, *own.values(), record["constant"][category]])
        theirs = record["paper"].get(category)
        if theirs:
            rows.append([f"{category}, paper", *(theirs[count] for count in counts), None])
    return text_table(["masks", *counts, "mean shape"], rows, decimals=2)
