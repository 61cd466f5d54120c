"""A small picture of a result: mask and silhouette of the first view, before and after."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from ..evaluation.footprint import common_window, in_window
from ..geometry.view import View
from ..refinement import RefineResult
from .overlay import compare, stages_of

SIDE, GAP = 96, 4  # px


def write_thumbnail(path: Path, result: RefineResult, views: Sequence[View]) -> None:
    """Write two squares of `SIDE` pixels, side by side, as PNG."""
    stages = stages_of(result, views[0], 0)
    window = common_window(stages)
    both = Image.new("RGB", (2 * SIDE + GAP, SIDE), "white")
    for number, (solid, stage) in enumerate(stages):
        colours = np.rint(compare(in_window(solid, stage, window)) * 255.0).astype(np.uint8)
        square = Image.fromarray(colours).resize((SIDE, SIDE), Image.Resampling.BOX)
        both.paste(square, (number * (SIDE + GAP), 0))
    both.quantize(16).save(path, format="PNG", optimize=True)
