"""The settings of an optimisation, with every value known."""

from __future__ import annotations

from dataclasses import dataclass

from ..pose.asked import Asked, Keep
from .presets import Mode, Preset


@dataclass(frozen=True)
class Settings:
    """A `RefineConfig` with the preset's values in place of None.

    points : most control points, None for all points.
    prior : "learned", "none" or the file of a prior.
    """

    mode: Mode
    preset: Preset
    steps: int
    learning_rate: float
    gamma: float
    symmetry: str
    sigma_sq: float
    device: str
    move: Asked
    keep: Keep
    accept_doubtful: bool
    point_confidence: bool
    points: int | None
    prior: str

    @property
    def smooth(self) -> bool:
        """Whether the default preset moves points."""
        return self.preset == "best" and self.mode == "points"
