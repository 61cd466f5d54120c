"""Colours that every chart shares, and the page they are drawn on."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from ..io.output import atomic_output, check_output

INK, BETTER, WORSE, PALE = "#333333", "#0072b2", "#d55e00", "#b8bec4"
# Safe for colour-blind readers.
COLOURS = (BETTER, WORSE, "#009e73", "#cc79a7", "#e69f00", "#56b4e9")


@contextmanager
def page(path: Path, overwrite: bool, size: tuple[float, float], dpi: int = 110) -> Iterator[Any]:
    """A figure of ``size`` inches that is written to ``path`` at the end of the block.

    Raises InputError if ``path`` cannot be written to.
    """
    check_output(path, overwrite)
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    yield figure
    for axis in figure.axes:
        axis.spines[["top", "right"]].set_visible(False)
        if not (len(axis.get_xticks()) or len(axis.get_yticks())):
            axis.set_axis_off()  # a picture, not a plot
    with atomic_output(path) as temporary:
        figure.savefig(temporary, dpi=dpi)
