"""What `tso eval` measures, and how."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from ..errors import InputError
from ..option import check, opt

METRICS = ("chamfer", "f_score", "emd", "iou")
# The fields of each metric in a record, in the order of the table.
FIELDS = {
    "chamfer": ("forward", "backward", "chamfer"),
    "f_score": ("precision", "recall", "f_score"),
    "emd": ("emd",),
    "iou": ("iou",),
}


@dataclass(frozen=True, kw_only=True)
class EvalConfig:
    """What to measure, and how; InputError for a value out of range.

    Prediction and target are sampled independently. ``label`` and ``mask_index`` say which object
    of a mask file is meant.

    chamfer : Chamfer distance. The default if no metric is named.
    f_score : F-score at the distance `threshold`.
    threshold : Distance up to which a point counts as found, for `f_score`.
    emd : Earth mover's distance. Both clouds need the same number of points. The protocol capnet
        squares its distances.
    iou : IoU of the prediction's silhouette and a mask; needs `mask`.
    protocol : plain: clouds as they are. capnet: the paper's normalisation, see above.
    points : Keep N points of every cloud, chosen by farthest-point sampling.
    samples : Points to sample from the surface of a mesh or voxel grid.
    as_vertices : Compare the vertices of meshes instead of their surfaces.
    sigma_sq : Draw the silhouette as the paper does, with Gaussians of this variance (px^2).
    seed : Seed of all random numbers.
    """

    chamfer: bool = opt(False, heading="Metrics")
    f_score: bool = opt(False)
    threshold: float | None = opt(
        None,
        "1 % of the target's longest side",
        above=0.0,
        below=math.inf,
        needs=("f_score",),
    )
    emd: bool = opt(False)
    iou: bool = opt(False)
    protocol: Literal["plain", "capnet"] = opt("plain", heading="Clouds")
    points: int | None = opt(None, "all; capnet 1024", least=2)
    samples: int = opt(16384, least=2)
    as_vertices: bool = opt(False, names=("vertices",))
    sigma_sq: float | None = opt(None, heading="Masks", above=0.0, below=math.inf, needs=("iou",))
    seed: int = opt(0, heading="Input and output", least=0, most=2**63 - 1)

    label: str | None = None
    mask_index: int | None = None

    def __post_init__(self) -> None:
        check(self)
        if self.points is not None and self.samples < self.points:
            raise InputError(
                f"`samples` is {self.samples}, expected at least {self.points}, as many as `points`"
            )

    @property
    def metrics(self) -> tuple[str, ...]:
        return tuple(name for name in METRICS if getattr(self, name)) or ("chamfer",)
