"""The measurement of speed as a study, for its tables, chart and page."""

from __future__ import annotations

from ..charts.speed_chart import draw_speed
from ..charts.speed_table import tables
from ..study import Shown

STUDY = Shown(
    name="speed",
    about="How fast is it, beside other ways and other packages?",
    parts=("points, paper", "points, best", "training"),
    tables=tables,
    draw=draw_speed,
    reading="Contestants for the same work take turns in one process. Trust ratios before times: two runs on a shared machine "
    "differ by up to half.",
)
