"""Studies that are done group by group, and go on from the record of an earlier start."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from ...errors import InputError
from .protocol import Report

Record = dict[str, Any]
Cases = list[dict[str, Any]]
Keep = Callable[[Record], None]
"""Called with the record so far."""


def cases_of(study: str, earlier: Record | None, settings: dict[str, Any]) -> Cases:
    """The cases of an earlier record; InputError if it is not of ``study`` or of other settings. None has no cases."""
    if earlier is None:
        return []
    if earlier.get("study") != study or not (
        isinstance(earlier.get("settings"), dict) and isinstance(earlier.get("cases"), list)
    ):
        found = earlier.get("study")
        raise InputError(f"the record to go on from is of the study {found!r}, expected one of tso lab {study}")
    for key, value in settings.items():
        found = earlier["settings"].get(key)
        if found != value:
            raise InputError(f"the record to go on from has {key} {found!r}, now it is {value!r}; expected the same")
    return list(earlier["cases"])


def complete(
    cases: Cases,
    groups: Sequence[Callable[[], Cases] | None],
    record: Callable[[Cases, bool], Record],
    doing: str,
    keep: Keep | None = None,
    report: Report | None = None,
) -> Record:
    """The record of ``cases`` and of what ``groups`` add to them, one after the other.

    Parameters
    ----------
    groups : what judges a group; None where ``cases`` has it already.
    record : of the cases so far, and whether these are all.
    keep : called after every group that was judged. report : after every group, with (doing, done, total).
    """
    for number, judge in enumerate(groups, 1):
        if judge is not None:
            cases = cases + judge()
            if keep:
                keep(record(cases, number == len(groups)))
        if report:
            report(doing, number, len(groups))
    return record(cases, True)
