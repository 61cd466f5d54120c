"""The script that draws the figures of the pages runs, and draws what the pages show."""

import runpy
import sys

import pytest
from PIL import Image

from tests.readme import DOCS

FIGURES = ("conventions.png", "families.png", "pipeline.png")


@pytest.mark.slow
def test_the_figures_are_drawn(tmp_path, monkeypatch):
    script = DOCS / "draw_figures.py"
    monkeypatch.setattr(sys, "argv", [script.name, str(tmp_path)])
    runpy.run_path(str(script), run_name="__main__")
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(FIGURES)
    for name in FIGURES:
        with Image.open(tmp_path / name) as drawn, Image.open(DOCS / name) as kept:
            assert drawn.size == kept.size
