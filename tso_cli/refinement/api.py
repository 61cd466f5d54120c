"""`refine`: test-stage optimisation (Eq. 7 of the paper) of a cloud by masks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from ..diagnosis.assumptions import Assumption
from ..diagnosis.findings import Finding
from ..errors import InputError
from ..geometry.camera import Camera
from ..kernels import blas
from ..optimisation.config import RefineConfig, config_of
from ..optimisation.loop import Progress
from .clock import Clock
from .result import RefineResult, as_given
from .run import run
from .scene import as_cloud, as_scene

if TYPE_CHECKING:
    from ..network.model import BaseNetwork


def refine(
    points: Any,
    masks: Any,
    cameras: Camera | Sequence[Camera] | None = None,
    config: RefineConfig | Mapping[str, Any] | None = None,
    *,
    assume: Sequence[str | Assumption] = (),
    network: BaseNetwork | None = None,
    image: Any = None,
    faces: Any = None,
    known: Sequence[Finding] = (),
    progress: Progress | None = None,
) -> RefineResult:
    """Move a cloud, a mesh, or the network that predicts a cloud, until it agrees with the masks.

    Parameters
    ----------
    points : [N, 3] or [1, N, 3] array or tensor, or a `Cloud`, which has its own colours and faces.
        Points of a cloud that are not finite are left out, with a warning. None in the network
        modes, where the network's prediction is the start.
    masks : one [H, W] array in [0, 1] or of 0 to 255, a picture of Pillow, a sequence of them, or
        `View` objects.
    cameras : one for each mask. None for the canonical camera, and for views, which have cameras.
    config : a `RefineConfig`, or its fields by name.
    assume : what the input is, if not as the conventions have it: names of hypotheses, such as
        "opengl" or "mask-flipped@NAME" for the view of that name alone.
    network : for the modes "encoder", "encoder-decoder" and "latent"; it is copied, never changed.
    image : [3, 64, 64] network input in [0, 1], array or tensor.
    faces : [F, 3] whole numbers, the triangles of a mesh, array or tensor. 1,024 points of the
        surface move, and the vertices follow.
    known : findings about the input that the result should have too.
    progress : called after every step with (step, steps, loss, points). The points [N, 3] are the
        control points, in the frame and unit of the cloud.

    Returns
    -------
    RefineResult. Its points are the best iterate of the preset's objective. If nothing is better
    than the start, the result is the start. If the points were given as a tensor, ``points`` and
    ``initial`` are tensors of the same device and dtype (of whole numbers: torch's default).

    Raises
    ------
    InputError
        Points, faces, masks or cameras that cannot be used or do not meet (`NoOverlapError`), or a
        mode that lacks its network.
    TsoError
        The loss of the start, or after the first step, is not a finite number.
    """
    given, settings = points, config_of(config).settings()
    clock, parameters = Clock(), None
    with clock.phase("prepare"):
        if settings.mode == "points":
            if points is None:
                raise InputError("mode points needs points, found none")
            points = as_cloud(points, "points", faces)
        else:
            from ..optimisation.network_parameters import NetworkParameters

            parameters = NetworkParameters(
                network, image, settings.mode, settings.device, settings.learning_rate
            )
            points = parameters.cloud.source
        scene = as_scene(points, masks, cameras, assume, known)
    with blas.one_thread():
        return as_given(run(scene, settings, clock, parameters, progress), given)
