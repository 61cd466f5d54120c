"""`tso lab failures`."""

from __future__ import annotations

from typing import Any

import click

from .trained import run, training_options


@click.command("failures")
@training_options
def command(**arguments: Any) -> None:
    """The failures that the paper names: narrow aeroplanes under a shared sigma^2, cars deformed in depth under one mask.

    Sizes of unseen aeroplanes over the true ones (body between nose and wing, span, length), and the errors of unseen cars
    along and across the line of sight. Reduced size: 900 steps of 8, 32 shapes a category.
    """
    from ..charts.training_charts import draw_failures
    from ..studies import failures

    run(failures, draw_failures, _table, failures.measure, **arguments)


def _table(record: dict[str, Any]) -> str:
    from ...plots.table import text_table

    summary = record["summary"]
    tables = []
    planes = {name: own for name, own in summary.items() if "span" in own}
    cars = {name: own for name, own in summary.items() if "depth" in own}
    if planes:
        keys = ("body_width", "body_height", "span", "length", "chamfer")
        rows: list[list[Any]] = [[name, *(own[key] for key in keys)] for name, own in planes.items()]
        header = ["aeroplanes, predicted / true", *(key.replace("_", " ") for key in keys)]
        tables.append(text_table(header, rows, decimals=2))
    if cars:
        rows = [
            [name, 1e3 * own["depth"], 1e3 * own["across"], own["depth"] / own["across"], own["extent"], own["chamfer"]]
            for name, own in cars.items()
        ]
        header = ["cars", "depth error x1000", "across", "ratio", "extent in depth, predicted / true", "chamfer"]
        tables.append(text_table(header, rows, decimals=2))
    return "\n\n".join(tables)
