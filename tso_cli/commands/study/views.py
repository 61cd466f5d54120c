"""`tso study views`."""

from __future__ import annotations

from typing import Any

import click

from .trained import run, training_options


@click.command("views")
@training_options
def views(**arguments: Any) -> None:
    """How many masks of each object supervise a step: 1, 2, 3, 4, 5, 6 and 8.

    Reduced size: cars alone, 800 steps of 8.
    """
    from ...report.training_charts import draw_views
    from ...studies import views

    run(views, draw_views, _table, **arguments)


def _table(record: dict[str, Any]) -> str:
    from ...report.table import text_table

    summary = record["summary"]
    counts = list(next(iter(summary.values())))
    rows: list[list[Any]] = []
    for category, own in summary.items():
        rows.append([category, *own.values()])
        if category in record["paper"]:
            theirs = {str(count): value for count, value in record["paper"][category].items()}
            rows.append([f"{category}, paper", *(theirs[count] for count in counts)])
    return text_table(["masks", *counts], rows, decimals=2)
