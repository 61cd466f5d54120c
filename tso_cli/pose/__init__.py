"""Where a cloud stands before its cameras, found from masks, in numpy."""

from typing import Literal

# What may move as one, by name; what stays where only one of two can be found; what moved.
Asked = Literal["auto", "shape", "pose", "similarity", "camera"]
Keep = Literal["auto", "size", "distance"]
Moved = Literal["nothing", "shift", "pose", "similarity", "camera"]
