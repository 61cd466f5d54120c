"""Names of objects that come in several variants."""

from __future__ import annotations


def shape_type(stem: str) -> str:
    """The name that variants of one object share: `fg_767_763` and `fg_767_767` are `fg_767`."""
    parts = stem.split("_")
    return "_".join(parts[:2]) if parts[0] == "fg" and len(parts) > 2 else stem
