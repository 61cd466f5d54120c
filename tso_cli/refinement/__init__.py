"""Test-stage optimisation: one loop, whose variants differ only in which parameters move."""

from __future__ import annotations

from .config import MODES, PRESETS, RefineConfig, RefineResult
from .run import refine, refine_batch

__all__ = ["MODES", "PRESETS", "RefineConfig", "RefineResult", "refine", "refine_batch"]
