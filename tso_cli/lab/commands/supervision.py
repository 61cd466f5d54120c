"""`tso lab supervision`."""

from __future__ import annotations

from typing import Any

import click

from .trained import run, training_options


@click.command("supervision")
@training_options
def command(**arguments: Any) -> None:
    """What a network learns from: 3D points, masks through the paper's projection, or two discrete projections in its place.

    A network of each kind for each category, and two for all categories at once, is trained on the list train of the split
    and judged on shapes it never saw, beside the mean training shape. Reduced size: 1,000 steps of 8, 32 shapes a category.
    """
    from ..charts.training_charts import draw_supervision
    from ..studies import supervision

    run(supervision, draw_supervision, _table, **arguments)


def _table(record: dict[str, Any]) -> str:
    from ...plots.table import text_table

    summary, paper = record["summary"], record["paper"]
    categories = [name for name in next(iter(summary.values())) if name != "mean"]
    rows: list[list[Any]] = []
    for name, own in summary.items():
        theirs = [paper.get(name, {}).get(category) for category in categories]
        mean = None if None in theirs or not theirs else sum(theirs) / len(theirs)
        rows.append([name, *(own[category] for category in categories), own["mean"], *theirs, mean])
    header = ["", *categories, "mean", *(f"paper's {categories[0]}", *categories[1:], "mean")]
    notes = [f"{name}: {text}" for name, text in record["notes"].items() if name in summary]
    return "\n".join([text_table(header, rows, decimals=2), *notes])
