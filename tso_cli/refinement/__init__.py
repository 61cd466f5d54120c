"""Test-stage optimisation: one loop, whose variants differ only in which parameters move."""

from __future__ import annotations

from .api import refine, refine_batch
from .config import MODES, PRESETS, RefineConfig, RefineResult

__all__ = ["MODES", "PRESETS", "RefineConfig", "RefineResult", "refine", "refine_batch"]
