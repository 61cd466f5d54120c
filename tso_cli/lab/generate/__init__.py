"""Chairs, cars and aeroplanes drawn by rule, to train on where real shapes are few.

y is up. Chairs and cars face +z and are symmetric about x = 0; aeroplanes fly toward -x and are symmetric about z = 0.
"""

from .folder import CATEGORIES, generate, write_shapes

__all__ = ["CATEGORIES", "generate", "write_shapes"]
