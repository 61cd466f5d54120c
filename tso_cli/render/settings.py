"""What to render of a mesh."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

from ..errors import InputError
from ..option import check, opt


class Size:
    """Reads ``64`` or ``128x96`` (width x height)."""

    name = "pixels"

    def convert(self, value: Any, *_: Any) -> tuple[int, int]:
        if isinstance(value, tuple):
            return value
        match = re.fullmatch(r"(\d{1,6})(?:x(\d{1,6}))?", str(value))
        if match is None:
            raise InputError(
                f"{value!r} is not a size, expected pixels such as 64, or width x height such as "
                "128x96"
            )
        return int(match[1]), int(match[2] or match[1])


@dataclass(frozen=True, kw_only=True)
class RenderSettings:
    """What to render of every mesh; InputError for impossible values.

    Each view draws azimuth and elevation uniformly from their ranges, in degrees. Farthest-point
    sampling keeps ``points`` of the ``samples`` of the surface.

    copies : Randomly warped copies to add of each mesh, for training.
    paint : Give the parts of each mesh random colours, for training.
    views : Images of each mesh.
    size : Size of the images: a side, or WIDTHxHEIGHT.
    elevation : Range of the camera's elevation, degrees.
    azimuth : Range of the camera's azimuth, degrees. At 0 the camera looks from +z.
    samples : Points to sample from the surface of each mesh.
    points : Points to keep of these samples as ground truth, evenly spread.
    """

    copies: int = opt(0, heading="Meshes", least=0, most=9999)
    paint: bool = opt(False)
    views: int = opt(24, heading="Images", least=1)
    size: tuple[int, int] = opt((64, 64), "64", metavar="PIXELS", parser=Size())
    elevation: tuple[float, float] = opt((-5.0, 40.0), metavar="FROM TO", least=-90.0, most=90.0)
    azimuth: tuple[float, float] = opt((0.0, 360.0), metavar="FROM TO", least=-360.0, most=360.0)
    samples: int = opt(16384, heading="Points", least=1)
    points: int = opt(1024, least=1)

    def __post_init__(self) -> None:
        check(self)
        if min(self.size) < 8 or max(self.size) > 8192:
            raise InputError(
                f"`size` is {self.size[0]}x{self.size[1]}, expected 8 to 8192 pixels each way"
            )
        for name in ("azimuth", "elevation"):
            low, high = getattr(self, name)
            if low > high:
                raise InputError(f"`{name}` is {low:g} to {high:g}, expected the smaller one first")
        if self.points > self.samples:
            raise InputError(
                f"`points` is {self.points} and `samples` {self.samples}, expected no more points "
                "than samples"
            )
