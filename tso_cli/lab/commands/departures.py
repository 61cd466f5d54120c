"""`tso lab departures`."""

from __future__ import annotations

from typing import Any

import click

from .trained import run, training_options


@click.command("departures")
@training_options
def command(**arguments: Any) -> None:
    """Where training departs from the paper or its authors' code, and what their way changes.

    Reduced size: chairs, 1,000 steps of 8.
    """
    from ..charts.training_charts import draw_supervision
    from ..studies import departures

    run(departures, draw_supervision, _table, **arguments)


def _table(record: dict[str, Any]) -> str:
    from ...plots.table import text_table

    summary = record["summary"]
    columns = list(next(iter(summary.values())))
    rows: list[list[Any]] = [[name, *(own[column] for column in columns)] for name, own in summary.items()]
    seeds = "; ".join(f"{name} {min(own):.2f} to {max(own):.2f}" for name, own in record["seeds"].items())
    return text_table(["setting", *columns], rows, decimals=2) + f"\nseeds of the first network: {seeds}"
