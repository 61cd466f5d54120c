"""Chamfer of trained networks over what a study varies; dashed lines with hollow marks are the paper's."""

from __future__ import annotations

from pathlib import Path

from ...plots.style import COLOURS, INK, page
from ..study import Record


def draw_lines(path: Path, record: Record, overwrite: bool = False, *, varied: str = "") -> None:
    """A line for each row of the summary, with single seeds and mean shapes."""
    columns = list(next(iter(record["summary"].values())))
    colours = dict(zip(record["summary"], COLOURS, strict=False))
    with page(path, overwrite, (7.6, 5.4)) as figure:
        axis = figure.subplots()
        for name, values in record["summary"].items():
            axis.plot(columns, list(values.values()), "o-", color=colours[name], label=name)
            for column, seeds in record.get("seeds", {}).get(name, {}).items():
                axis.plot([column] * len(seeds), seeds, "_", color=colours[name], markersize=10)
        for name, constant in record.get("constant", {}).items():
            axis.axhline(constant, color=colours[name], linewidth=0.8, linestyle=":", label=f"{name}, mean training shape")
        for name in (name for name in record["paper"] if name in record["settings"]["shapes"]):
            values = record["paper"][name]
            line = axis.plot(list(values), list(values.values()), "D--", color=colours.get(name, INK), label=f"{name}, paper")[
                0
            ]
            line.set(markerfacecolor="white", markeredgecolor=INK, markersize=5)
        axis.set_ylim(bottom=0.0)
        axis.set_xlabel(varied)
        axis.set_ylabel("Chamfer x1000 (scaled by own box)")
        figure.legend(loc="outside lower center", ncols=len(colours), frameon=False)
