"""The settings of an optimisation, with every value known."""

from __future__ import annotations

from dataclasses import dataclass, replace

from ..io.shipped import NO_PRIOR
from ..pose.asked import Asked, Keep
from .presets import Mode, Preset, default_steps


@dataclass(frozen=True)
class Settings:
    """A `RefineConfig` with the preset's values in place of None.

    points : most control points, None for all points.
    prior : "learned", "none" or the file of a prior.
    given : names of the values that the caller chose.
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
    given: frozenset[str]

    def for_observations(self, count: int) -> Settings:
        """The same with the default steps for this many masks, depth maps and photos."""
        if not self.smooth or "steps" in self.given:
            return self
        return replace(self, steps=default_steps(count, self.prior != NO_PRIOR))

    @property
    def smooth(self) -> bool:
        """Whether the default preset moves points."""
        return self.preset == "best" and self.mode == "points"
