"""tso: make a 3D point cloud agree with a picture."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from .version import __version__ as __version__

if TYPE_CHECKING:
    from .errors import GateError, InputError, Interrupted, TsoError
    from .evaluation.metrics import Chamfer, FScore, chamfer, emd, f_score, iou
    from .files import (
        draw_overlay,
        read_camera,
        read_cameras,
        read_cloud,
        read_depth,
        read_image,
        read_mask,
        write_cameras,
        write_cloud,
        write_depth,
        write_mask,
    )
    from .geometry.camera import Camera
    from .geometry.view import View
    from .io.clouds import PointCloud
    from .optimisation.presets import Mode, Preset
    from .pose.fit import FittedCamera, fit_camera
    from .refinement import RefineConfig, RefineResult, refine, refine_batch, refine_each
    from .train.mask_loss import MaskLoss

_WHERE = {
    "Camera": "geometry.camera",
    "Chamfer": "evaluation.metrics",
    "FScore": "evaluation.metrics",
    "FittedCamera": "pose.fit",
    "MaskLoss": "train.mask_loss",
    "Mode": "optimisation.presets",
    "PointCloud": "io.clouds",
    "Preset": "optimisation.presets",
    "chamfer": "evaluation.metrics",
    "emd": "evaluation.metrics",
    "f_score": "evaluation.metrics",
    "fit_camera": "pose.fit",
    "iou": "evaluation.metrics",
    "draw_overlay": "files",
    "read_camera": "files",
    "read_cameras": "files",
    "read_cloud": "files",
    "read_depth": "files",
    "read_image": "files",
    "read_mask": "files",
    "write_cameras": "files",
    "write_cloud": "files",
    "write_depth": "files",
    "write_mask": "files",
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
    "Chamfer",
    "FScore",
    "FittedCamera",
    "GateError",
    "InputError",
    "Interrupted",
    "MaskLoss",
    "Mode",
    "PointCloud",
    "Preset",
    "RefineConfig",
    "RefineResult",
    "TsoError",
    "View",
    "chamfer",
    "draw_overlay",
    "emd",
    "f_score",
    "fit_camera",
    "iou",
    "read_camera",
    "read_cameras",
    "read_cloud",
    "read_depth",
    "read_image",
    "read_mask",
    "refine",
    "refine_batch",
    "refine_each",
    "write_cameras",
    "write_cloud",
    "write_depth",
    "write_mask",
]


def __dir__() -> list[str]:
    """What an editor offers."""
    return __all__


def __getattr__(name: str) -> Any:
    """Load public names when first used: importing tso_cli does not import torch."""
    if name in _WHERE:
        from importlib import import_module

        try:
            module = import_module(f".{_WHERE[name]}", __name__)
        except ImportError as error:
            from .errors import missing_extra

            if (message := missing_extra(error, f"{name} needs")) is None:
                raise
            raise type(error)(message, name=error.name) from None
        value = getattr(module, name)
        globals()[name] = value
        return value
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
