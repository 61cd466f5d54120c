"""Test-stage optimisation: one loop, whose variants differ only in which parameters move."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ..optimisation.config import RefineConfig as RefineConfig
    from ..optimisation.presets import MODES as MODES
    from ..optimisation.presets import PRESETS as PRESETS
    from .api import refine as refine
    from .batch import refine_batch as refine_batch
    from .batch import refine_each as refine_each
    from .result import RefineResult as RefineResult

_MODULES = {
    "refine": ".api",
    "refine_batch": ".batch",
    "refine_each": ".batch",
    "RefineConfig": "..optimisation.config",
    "RefineResult": ".result",
    "MODES": "..optimisation.presets",
    "PRESETS": "..optimisation.presets",
}
__all__ = [
    "MODES",
    "PRESETS",
    "RefineConfig",
    "RefineResult",
    "refine",
    "refine_batch",
    "refine_each",
]


def __getattr__(name: str) -> Any:
    """Load public names when first used, so that reading the settings is quick."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_MODULES[name], __name__), name)
