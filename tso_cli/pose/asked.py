"""What may move as one, by name."""

from __future__ import annotations

from typing import Literal, get_args

Asked = Literal["auto", "shape", "pose", "similarity", "camera"]
Keep = Literal["auto", "size", "distance"]
Moved = Literal["nothing", "shift", "pose", "similarity", "camera"]
ASKED: tuple[Asked, ...] = get_args(Asked)
KEEPS: tuple[Keep, ...] = get_args(Keep)
