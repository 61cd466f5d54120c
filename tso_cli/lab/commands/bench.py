"""`tso bench`: speed on this machine, accuracy against seconds, and how wrong the input may be."""

from __future__ import annotations

import click

from ..studies import BENCHES
from . import StudyGroup, lines


@click.group("bench", cls=StudyGroup, sections={"Commands": lines(BENCHES)})
def command() -> None:
    """Measure speed, accuracy or stability, and keep the answer as JSON beside a chart and a page."""
