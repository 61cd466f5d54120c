"""Where a cloud falls in a view: the check before any optimisation, and the placing of a network's cloud."""

from __future__ import annotations

import warnings
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..geometry.camera import CANONICAL_DISTANCE, CANONICAL_ROTATION, NEAR, Camera
from ..geometry.view import View

# Boxes of mask and projected cloud that overlap less than this belong to different cameras, units or axes.
SMALLEST_BOX_IOU = 0.05
# Twenty steps of a 200th bring a cloud by a tenth of its longest side; more of them change no result.
SETTLING_STEPS, SETTLING_STEP = 20, 0.005
# A mask of fewer foreground pixels says little of a shape; nor does one of fewer along its longer side that are each wider than
# the spacing of the projected points.
FEWEST_PIXELS, FEWEST_ACROSS = 16, 16

Array = NDArray[np.float64]
Box = tuple[float, float, float, float]


@dataclass(frozen=True)
class Placement:
    """How a cloud and a mask meet in one view.

    Attributes
    ----------
    points : how many there are; behind : at or behind the camera; inside_image, inside_mask : where the others fall.
    depth : nearest and farthest depth of the points in front, world units (None if there are none).
    points_box : left, top, right, bottom edges of the projected cloud in pixels, cut to the image (None if it is not seen).
    mask_box : the same of the mask's foreground.
    box_iou : intersection over union of the two boxes.
    """

    points: int
    behind: int
    inside_image: int
    inside_mask: int
    depth: tuple[float, float] | None
    points_box: Box | None
    mask_box: Box
    box_iou: float

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return asdict(self)


def place(points: Array, view: View) -> Placement:
    """Project ``points`` [N, 3] (world units) into ``view`` and count where they fall."""
    camera = view.camera
    pixels, depth = camera.project(points)
    front = np.isfinite(pixels).all(1)
    if camera.model == "perspective":
        front &= depth > NEAR * np.ptp(points, axis=0).max()
    seen = pixels[front]
    columns, rows = np.rint(seen).T
    inside = (columns >= 0) & (rows >= 0) & (columns < camera.width) & (rows < camera.height)
    on_mask = view.mask[rows[inside].astype(int), columns[inside].astype(int)] > 0.5
    mask_box = _plain(view.box())
    box, overlap = None, 0.0
    if len(seen):
        # Half a pixel around the points: a cloud of one column still has a width, as the mask's box does.
        low = np.maximum(seen.min(0) - 0.5, -0.5)
        high = np.minimum(seen.max(0) + 0.5, [camera.width - 0.5, camera.height - 0.5])
        if (high > low).all():
            box = _plain((*low, *high))
            overlap = box_iou(box, mask_box)
    distances = (float(depth[front].min()), float(depth[front].max())) if len(seen) else None
    return Placement(len(points), int((~front).sum()), int(inside.sum()), int(on_mask.sum()), distances, box, mask_box, overlap)


def mask_doubts(view: View, points: int) -> list[str]:
    """What is to be known of a mask for a cloud of so many ``points``, in words: that it is coarse, or has strays."""
    found = [coarse] if (coarse := _coarse(view, points)) else []
    if view.specks:
        found.append(f"{view.name}: foreground far from the object is left out ({view.specks} px)")
    return found


def _coarse(view: View, points: int) -> str | None:
    pixels = int(view.inside.sum())
    left, top, right, bottom = view.box()
    side = round(max(right - left, bottom - top))
    # A surface is projected twice, its front and its back: with over two points on a pixel they lie closer than it is wide.
    if pixels >= FEWEST_PIXELS and (side >= FEWEST_ACROSS or points <= 2 * pixels):
        return None
    if side == 1:
        return f"{view.name}: shows the object with a single pixel, which tells where it is and nothing of its shape"
    return f"{view.name}: shows the object with only {pixels} pixels: details smaller than 1/{side} of its size cannot be seen"


def _plain(box: Any) -> Box:
    left, top, right, bottom = (float(edge) for edge in box)
    return left, top, right, bottom


def box_iou(a: Box, b: Box) -> float:
    """Intersection over union of two boxes (left, top, right, bottom)."""
    width = min(a[2], b[2]) - max(a[0], b[0])
    height = min(a[3], b[3]) - max(a[1], b[1])
    common = max(width, 0.0) * max(height, 0.0)
    union = (a[2] - a[0]) * (a[3] - a[1]) + (b[2] - b[0]) * (b[3] - b[1]) - common
    return common / union if union > 0.0 else 0.0


def require_overlap(placement: Placement, view: View) -> None:
    """Refuse a cloud and a mask that do not meet; warn of points behind the camera.

    Raises
    ------
    InputError
        All points lie behind the camera, none falls inside the image, or the boxes' IoU is at most 0.05.
    """
    advice = (
        "check the camera's axes (OpenCV: x right, y down, z forward; X_camera = R X_world + t) and units, "
        "or look at the numbers with --check"
    )
    if placement.behind == placement.points:
        raise InputError(f"{view.name}: all {placement.points} points lie behind the camera; {advice}")
    if not placement.inside_image or placement.points_box is None:
        raise InputError(f"{view.name}: no point falls inside the {view.camera.width}x{view.camera.height} image; {advice}")
    if placement.box_iou <= SMALLEST_BOX_IOU:
        raise InputError(
            f"{view.name}: the projected cloud ({describe_box(placement.points_box)}) and the mask "
            f"({describe_box(placement.mask_box)}) hardly meet: IoU of the boxes {placement.box_iou:.3f}, expected over "
            f"{SMALLEST_BOX_IOU}; {advice}"
        )
    if placement.behind:
        warnings.warn(
            f"{view.name}: {placement.behind} of {placement.points} points lie behind the camera and take no part", stacklevel=2
        )


def describe_box(box: Box) -> str:
    """``box`` in words, rounded to whole pixels."""
    left, top, right, bottom = (round(edge) for edge in box)
    return f"columns {left} to {right}, rows {top} to {bottom}"


def place_in_front(points: Array, view: View) -> Camera:
    """The canonical camera with the view's K, moved so that a view-aligned cloud fills the mask's box.

    A network sees a crop: it can tell neither the object's distance from its size nor, for a photo of unknown focal length,
    the two from the zoom. Axes are the canonical ones; the distance is that at which the longer side of the projected box
    equals the mask's, and the sideways shift centres the box on the mask's. Where K is the training renders' own this
    is a distance close to the canonical 2.

    Parameters
    ----------
    points : [N, 3] view-aligned (x right, y up, z toward the viewer), about centred.
    view : mask and camera; of the camera only K, width and height are used.
    """
    left, top, right, bottom = view.box()
    wanted, middle = max(right - left, bottom - top), np.array([left + right, top + bottom]) / 2.0
    camera = replace(view.camera, R=CANONICAL_ROTATION, t=np.array([0.0, 0.0, CANONICAL_DISTANCE]), model="perspective")
    focal = camera.K[[0, 1], [0, 1]]
    # Perspective makes box size and distance almost inversely proportional: a few rounds reach rounding error.
    nearest = float(points[:, 2].max()) + 0.1
    for _ in range(50):
        pixels, _ = camera.project(points)
        low, high = pixels.min(0) - 0.5, pixels.max(0) + 0.5
        distance = max(camera.t[2] * float((high - low).max()) / wanted, nearest)
        shift = (middle - (low + high) / 2.0) / focal * distance
        moved = np.array([camera.t[0] + shift[0], camera.t[1] + shift[1], distance])
        if np.abs(moved - camera.t).max() < 1e-9 * distance:
            break
        camera = replace(camera, t=moved)
    return camera


def settle(points: Array, view: View, sigma_sq: float | None = None, steps: int = SETTLING_STEPS) -> Camera:
    """The view's camera, shifted to where the silhouette of a cloud agrees best with the mask (BCE, Eq. 4).

    A box hangs on the outermost points of a prediction, and a prediction's are wrong. What the silhouette of the whole cloud
    says is steadier; and whatever of the misfit a shift explains is then no longer asked of the shape.

    Parameters
    ----------
    points : [N, 3], in the frame that the camera's R and t take to it.
    view : mask and a camera that is about right already, as `place_in_front` gives it.
    sigma_sq : px^2; None for the view's default.
    steps : of Adam, each of at most about 1/200 of the cloud's longest side.

    Returns
    -------
    The camera with another t: the best of the steps, the start being one of them.
    """
    import torch

    from ..silhouette.bce import PixelWeights, mask_loss
    from ..silhouette.projection import CameraBatch, default_sigma_sq, project
    from .adam import Adam

    cloud = torch.as_tensor(points, dtype=torch.float32)[None]
    sigma_sq = default_sigma_sq(view.camera.width, view.camera.height) if sigma_sq is None else sigma_sq
    known = None if view.known is None else torch.as_tensor(view.known, dtype=torch.float32)[None]
    target = PixelWeights.of(torch.as_tensor(view.mask, dtype=torch.float32)[None], known)
    cameras = CameraBatch.of([view.camera], cloud)
    shift = torch.zeros(3, requires_grad=True)
    optimiser = Adam([shift], SETTLING_STEP * float(np.ptp(points, axis=0).max()))
    lowest, best = np.inf, np.zeros(3)
    for step in range(steps + 1):
        seen = project(cloud, replace(cameras, t=cameras.t + shift))
        loss = mask_loss(seen.points_px[:, 0], seen.valid[:, 0], target, sigma_sq).sum()
        if loss.item() < lowest:
            lowest, best = loss.item(), shift.detach().double().numpy().copy()
        if step < steps:
            optimiser.step(loss)
    return replace(view.camera, t=view.camera.t + best)


def view_to_world(points: Array, placed: Camera, camera: Camera) -> Array:
    """Take a view-aligned cloud that ``placed`` projects onto the picture into the world of ``camera``.

    The picture fixes the cloud up to a scale about the camera's centre; it is chosen so that the placed cloud's origin comes to
    the depth of the world's origin.

    Raises
    ------
    InputError
        The world's origin is not in front of ``camera``.
    """
    if camera.t[2] <= 0.0:
        raise InputError(f"the world's origin has depth {camera.t[2]:g} in this camera, expected it in front (> 0)")
    seen = (points @ placed.R.T + placed.t) * (camera.t[2] / placed.t[2])
    return (seen - camera.t) @ camera.R
