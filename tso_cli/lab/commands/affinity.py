"""`tso lab affinity`."""

from __future__ import annotations

from typing import Any

import click

from .trained import run, training_options


@click.command("affinity")
@training_options
def command(**arguments: Any) -> None:
    """Does the affinity loss remove outliers?

    Networks trained without it and with each of its forms; an outlier is a point that falls more than a pixel outside the mask,
    in views of unseen shapes that the network was not given. Reduced size: 500 steps of 8, 32 shapes a category.
    """
    from ..charts.training_charts import draw_affinity
    from ..studies import affinity

    run(affinity, draw_affinity, _table, affinity.measure, **arguments)


def _table(record: dict[str, Any]) -> str:
    from ...plots.table import text_table

    rows: list[list[Any]] = [
        [name, category, 100.0 * values["outliers"], values["chamfer"]]
        for name, own in record["summary"].items()
        for category, values in own.items()
    ]
    return text_table(["affinity loss", "category", "outliers, %", "Chamfer"], rows, decimals=2)
