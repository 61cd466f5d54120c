"""The colours of all charts, and figures that are written to files."""

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
def page(
    path: Path, overwrite: bool, size: tuple[float, float], dpi: int = 110, frames: bool = False
) -> Iterator[Any]:
    """A figure of ``size`` inches, written to ``path`` in 256 colours after the block.

    Without ``frames`` charts have no top and right spine, and images have no spines. Raises
    InputError if the file cannot be written.
    """
    check_output(path, overwrite)
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.text import Text
    from PIL import Image

    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    yield figure
    for axis in figure.axes if not frames else ():
        axis.spines[["top", "right"]].set_visible(False)
        if not (len(axis.get_xticks()) or len(axis.get_yticks())):
            axis.set_axis_off()
    for words in figure.findobj(Text):
        # Names of files may hold what no font can draw.
        words.set_text(words.get_text().encode("utf-8", "backslashreplace").decode())
    with atomic_output(path, overwrite) as temporary:
        figure.savefig(temporary, dpi=dpi)
        with Image.open(temporary) as picture:
            small = picture.convert("RGB").quantize(256, dither=Image.Dither.NONE)
        small.save(temporary, optimize=True)
