"""Records that a study goes on from."""

from __future__ import annotations

from typing import Any

from ..errors import InputError


def cases_of(study: str, earlier: dict[str, Any] | None, settings: dict[str, Any]) -> list[dict[str, Any]]:
    """The cases of an earlier record; InputError if it is not of ``study`` or of other settings. None has no cases."""
    if earlier is None:
        return []
    if earlier.get("study") != study or not (
        isinstance(earlier.get("settings"), dict) and isinstance(earlier.get("cases"), list)
    ):
        found = earlier.get("study")
        raise InputError(f"the record to go on from is of the study {found!r}, expected one of tso study {study}")
    for key, value in settings.items():
        found = earlier["settings"].get(key)
        if found != value:
            raise InputError(f"the record to go on from has {key} {found!r}, now it is {value!r}; expected the same")
    return list(earlier["cases"])
