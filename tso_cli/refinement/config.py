"""What a caller may choose: `RefineConfig`."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..cloud.control_points import CONTROL_POINTS
from ..errors import InputError
from ..geometry.points import CANDIDATES
from ..io.shipped import LEARNED, NO_PRIOR
from ..optimisation.presets import (
    DEFAULTS,
    FEWEST_CONTROL_POINTS,
    MODES,
    PRESETS,
    SIGMA_SQ,
    Mode,
    Preset,
)
from ..optimisation.settings import Settings
from ..optimisation.symmetry import parse_symmetry
from ..pose.asked import ASKED, KEEPS, Asked, Keep


@dataclass(frozen=True)
class RefineConfig:
    """Settings of one refinement. None stands for the preset's value.

    Parameters
    ----------
    mode : what is optimised: "points", "encoder" or "encoder-decoder" (the network's weights), or
        "latent" (the vector of 128 numbers between encoder and decoder).
    steps : of the optimiser; 0 returns the start.
    learning_rate : of Adam, for a cloud of longest side 1.
    gamma : weight of the Chamfer distance to the start, for a cloud of longest side 1; with
        preset "paper".
    sigma_sq : variance of the projection's Gaussian in squared cells of a window of 64; with preset
        "paper". The default is the paper's, 0.4.
    device : where the network is: "cpu", "cuda", "auto" or any name torch knows. Points mode has
        no network, and runs on the CPU.
    preset : "best", or "paper": Eq. 7 with the paper's settings.
    symmetry : "auto" searches a mirror plane of the start; "none"; "x", "y", "z": the axis normal
        to a plane through the middle of the start's bounding box; or "a,b,c,d": the plane
        ax + by + cz = d. The default is "auto" with "best" in points mode, else "none".
    move : what may move as one before the shape is refined, in points mode: "shape" (nothing),
        "pose" (the cloud turns and shifts), "similarity" (its size may change too), "camera" (each
        camera turns and shifts by itself), or "auto" (the cloud turns and shifts where that
        explains the misfit and other proportions do not). The default is "auto" with "best" in
        points mode, else "shape".
    keep : what stays, where one camera cannot tell the size of a cloud from its distance: "size",
        "distance", or "auto" (the distance for a shift and a similarity, else the size).
    only : move as one, and leave the shape as it is.
    accept_doubtful : move the points also where the cloud would be left as it was.
    point_confidence : also find how far the evidence determines each point.
    points : most control points: points that move by themselves, while the others follow (16 to
        16,384; of a mesh at most 4,096). With "best" in points mode the default is 1,024.
        Otherwise all points move.
    prior : what is known about shapes of the cloud's kind: "learned", the prior that comes with the
        program; "none"; or the path of a file that `tso train --prior` has written. The default is
        "learned" with "best" in points mode, else "none".

    The defaults of ``steps``, ``learning_rate`` and ``gamma``, by preset and mode, are the table
    `DEFAULTS` in ``optimisation/presets.py``.

    Raises
    ------
    InputError
        A value is out of range.
    """

    mode: Mode = "points"
    steps: int | None = None
    learning_rate: float | None = None
    gamma: float | None = None
    sigma_sq: float | None = None
    device: str = "cpu"
    preset: Preset = "best"
    symmetry: str | None = None
    move: Asked | None = None
    keep: Keep = "auto"
    only: bool = False
    accept_doubtful: bool = False
    point_confidence: bool = False
    points: int | None = None
    prior: str | Path | None = None

    def __post_init__(self) -> None:
        choices = {"mode": MODES, "preset": PRESETS, "move": (None, *ASKED), "keep": KEEPS}
        for name, known in choices.items():
            if getattr(self, name) not in known:
                found = f"{name} is {getattr(self, name)!r}"
                raise InputError(f"{found}, expected one of {', '.join(filter(None, known))}")
        moves = self.move not in (None, "shape")
        if moves and self.mode != "points":
            raise InputError(
                f"mode is {self.mode!r}, expected points for move {self.move}: the other modes "
                "place their cloud themselves"
            )
        if self.only and (self.move == "shape" or not (moves or self._smooth)):
            raise InputError(
                "only the move is to be done and nothing may move, expected move pose, similarity, "
                "camera or auto"
            )
        if self.only and self.steps:
            raise InputError(f"only the move is to be done, found {self.steps} steps too")
        if self.keep != "auto" and self.move in ("shape", "camera"):
            raise InputError(
                f"keep is {self.keep!r}, which is for a cloud that moves, found move {self.move}"
            )
        self._require_whole("steps", 0, None)
        self._require_whole("points", FEWEST_CONTROL_POINTS, CANDIDATES)
        self._require_number("learning_rate", 1e6)
        self._require_number("sigma_sq", 1e9)
        self._require_number("gamma", 1e15, zero=True)
        if self.mode == "points" and self.device not in ("cpu", "auto"):
            raise InputError(
                f"device is {self.device!r}, expected cpu or auto: mode points has no network to "
                "put there"
            )
        if self.symmetry is not None:
            parse_symmetry(self.symmetry)
        smooth_only = {
            "points": self.points is not None,
            "point_confidence": self.point_confidence,
            "prior": self.prior is not None and str(self.prior) != NO_PRIOR,
        }
        for name, used in smooth_only.items():
            if used and (self.preset, self.mode) != ("best", "points"):
                raise InputError(
                    f"`{name}` is for mode points with preset best, "
                    f"found {self.mode} with {self.preset}"
                )
        for name in ("gamma", "sigma_sq"):
            if getattr(self, name) is not None and self.preset != "paper":
                raise InputError(f"`{name}` is for preset paper, found {self.preset}")

    def _require_whole(self, name: str, low: int, high: int | None) -> None:
        value = getattr(self, name)
        whole = isinstance(value, int) and not isinstance(value, bool)
        if value is None or (whole and low <= value <= (math.inf if high is None else high)):
            return
        expected = f"{low} or more" if high is None else f"from {low} to {high:,}"
        comma = "," if high is None else ""
        raise InputError(f"{name} is {value!r}, expected a whole number{comma} {expected}")

    def _require_number(self, name: str, most: float, zero: bool = False) -> None:
        value = getattr(self, name)
        if value is None:
            return
        number = isinstance(value, (int, float))
        if not (number and (value > 0.0 or (zero and value == 0.0)) and value <= most):
            sign = ">=" if zero else ">"
            raise InputError(f"{name} is {value!r}, expected a number {sign} 0, at most {most:g}")

    @property
    def _smooth(self) -> bool:
        """As `Settings.smooth`."""
        return self.preset == "best" and self.mode == "points"

    def settings(self) -> Settings:
        """The same with the preset's values in place of None."""
        preset, smooth = DEFAULTS[self.preset, self.mode], self._smooth
        defaults: dict[str, Any] = dict(
            steps=preset.steps,
            learning_rate=preset.learning_rate,
            gamma=preset.gamma,
            symmetry="auto" if smooth else "none",
            sigma_sq=SIGMA_SQ,
            prior=LEARNED if smooth else NO_PRIOR,
            move="auto" if smooth else "shape",
            points=CONTROL_POINTS if smooth else None,
        )
        chosen = {
            name: value
            for name, value in vars(self).items()
            if value is not None and name != "only"
        }
        if self.only:
            chosen["steps"] = 0
        if "prior" in chosen:
            chosen["prior"] = str(chosen["prior"])
        return Settings(**(defaults | chosen))
