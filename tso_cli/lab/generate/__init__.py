"""Shapes drawn by rule, to train on where real ones are few: chairs, cars and aeroplanes, no two alike.

y is up. Chairs and cars face +z and are symmetric about x = 0; aeroplanes fly toward -x and are symmetric about z = 0.
"""

from __future__ import annotations

from .folder import CATEGORIES, generate, write_shapes

__all__ = ["CATEGORIES", "generate", "write_shapes"]
