"""tso: make a 3D point cloud agree with a picture."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from .version import __version__ as __version__

if TYPE_CHECKING:
    from .errors import GateError, InputError, Interrupted, TsoError
    from .geometry.camera import Camera
    from .geometry.view import View
    from .refinement import RefineConfig, RefineResult, refine, refine_batch, refine_each

_WHERE = {
    "Camera": "geometry.camera",
    "TsoError": "errors",
    "InputError": "errors",
    "GateError": "errors",
    "Interrupted": "errors",
    "RefineConfig": "refinement",
    "RefineResult": "refinement",
    "refine": "refinement",
    "refine_batch": "refinement",
    "refine_each": "refinement",
    "View": "geometry.view",
}
__all__ = [
    "Camera",
    "GateError",
    "InputError",
    "Interrupted",
    "RefineConfig",
    "RefineResult",
    "TsoError",
    "View",
    "refine",
    "refine_batch",
    "refine_each",
]


def __getattr__(name: str) -> Any:
    """Load public names when first used: importing tso_cli does not import torch."""
    if name in _WHERE:
        from importlib import import_module

        module = import_module(f".{_WHERE[name]}", __name__)
        value = getattr(module, name)
        globals()[name] = value
        return value
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
