"""`tso study`: a command for each question."""

from __future__ import annotations

import click

from .accuracy import accuracy
from .affinity import affinity
from .departures import departures
from .evidence import evidence
from .examples import examples
from .failures import failures
from .fingerprint import fingerprint
from .network import network
from .points import points
from .pose import pose
from .sigma import sigma
from .supervision import supervision
from .variants import variants
from .views import views
from .weight import weight


@click.group("study")
def command() -> None:
    """Ask a question of the method, on many shapes, and keep the answer as JSON beside a chart."""


for study in (
    points,
    accuracy,
    evidence,
    pose,
    examples,
    network,
    variants,
    sigma,
    supervision,
    views,
    weight,
    affinity,
    failures,
    departures,
    fingerprint,
):
    command.add_command(study)
