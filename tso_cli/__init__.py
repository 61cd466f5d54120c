"""tso: make a 3D point cloud agree with a picture."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from .camera import Camera as Camera
    from .errors import GateError as GateError
    from .errors import InputError as InputError
    from .errors import TsoError as TsoError
    from .refinement import RefineConfig as RefineConfig
    from .refinement import RefineResult as RefineResult
    from .refinement import refine as refine
    from .refinement import refine_batch as refine_batch
    from .scene import View as View

_WHERE = {
    "Camera": "camera",
    "TsoError": "errors",
    "InputError": "errors",
    "GateError": "errors",
    "RefineConfig": "refinement",
    "RefineResult": "refinement",
    "refine": "refinement",
    "refine_batch": "refinement",
    "View": "scene",
}
__all__ = ["Camera", "GateError", "InputError", "RefineConfig", "RefineResult", "TsoError", "View", "refine", "refine_batch"]


def __getattr__(name: str) -> Any:
    """Load public names when first used: importing tso_cli does not import torch."""
    if name in _WHERE:
        from importlib import import_module

        module = import_module(f".{_WHERE[name]}", __name__)
        value = getattr(module, name)
        globals()[name] = value
        return value
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
