"""Which method a record is of: beside its figures it keeps what that method did to the shipped examples.

A record of another method than today's is not gone on from, and no page may show it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from ...errors import InputError
from ...io.reading import shown
from .fingerprint_parts import PARTS, Numbers

Record = dict[str, Any]
Fingerprint = dict[str, Numbers]

KEY = "fingerprint"
# Shares up to which two numbers are the same. On one or two threads, in plain or compiled loops, with another BLAS or set of
# instructions they differ by 3e-4 at most. Where points move in stages the last bit of a start can choose other nodes, which
# more masks and steps amplify: there Chamfer distances differ by up to 0.014, the ways of the points by up to 0.029.
TOLERANCE = 0.005
STAGED, STAGED_TOLERANCES = "points, best", {"Chamfer": 0.02, "moved": 0.04, "IoU": 0.01}

PAPER, BEST = "points, paper", "points, best"
FOUR = "four masks"
NETWORKS = tuple(f"{mode}, {preset}" for mode in ("encoder", "encoder-decoder", "latent") for preset in ("paper", "best"))
MASKS, PRINTED = "training on masks", "training on masks, printed affinity"
OTHERS = ("training on masks, plain projection", "training on masks, depth projection")
POINTS, MEAN = "training on points", "mean shape"
PICTURES, PREDICTION = "pictures", "prediction"
QUESTIONS = {
    "framing": (BEST, f"{BEST}, in a larger photo", f"{BEST}, in photos of other widths each"),
    "depth": (BEST, f"{BEST}, depth map"),
    "colours": (BEST, f"{BEST}, photo"),
    "missing": (BEST,),
    "wrong": (f"{PAPER}, {FOUR}", f"{BEST}, {FOUR}"),
    "cameras": (BEST, f"{BEST}, camera refined"),
    "placing": (PREDICTION, PAPER, BEST, "latent, best"),
    "rates": (PREDICTION, BEST, *NETWORKS),
    "meshes": (BEST, f"{BEST}, mesh"),
}
TIMED = {
    "silhouette": (PAPER,),
    "chamfer": (PAPER,),
    "step": (PAPER,),
    "batch": (PAPER, BEST),
    "step, encoder": ("encoder, paper",),
    "step, encoder-decoder": ("encoder-decoder, paper",),
    "training, points": (POINTS,),
    "training, masks": (MASKS,),
    "start-up": (BEST,),
}
JUDGED: dict[str, Callable[[Record], Iterable[str]]] = {
    "points": lambda record: [PICTURES, PAPER],
    "examples": lambda record: [PREDICTION, *(f"{row['mode']}, paper" for row in record["examples"])],
    "tso": lambda record: [PICTURES, PREDICTION, PAPER, "encoder, paper", "encoder-decoder, paper"],
    "accuracy": lambda record: [PICTURES, *_of_accuracy(**record["settings"])],
    "evidence": lambda record: [PICTURES, *(part for name in record["settings"]["questions"] for part in QUESTIONS[name])],
    "pose": lambda record: [PICTURES, "camera fitted"],
    "network": lambda record: [PICTURES, PREDICTION, MEAN],
    "sigma": lambda record: [PICTURES, "silhouette"],
    "supervision": lambda record: [PICTURES, POINTS, MASKS, *OTHERS, MEAN],
    "views": lambda record: [PICTURES, MASKS, MEAN],
    "lambda": lambda record: [PICTURES, MASKS, PRINTED],
    "affinity": lambda record: [PICTURES, MASKS, PRINTED],
    "failures": lambda record: [PICTURES, MASKS],
    "departures": lambda record: [PICTURES, MASKS],
    "photos": lambda record: [PAPER, BEST, f"{PAPER}, {FOUR}", f"{BEST}, {FOUR}"],
    "speed": lambda record: [part for row in record["records"] for part in TIMED.get(row["what"], ())],
}
"""Study -> what its record judges, of `PARTS`."""

_known: Fingerprint = {}


def _of_accuracy(kinds: list[str], ablation: bool, **_: Any) -> Iterable[str]:
    yield from (PAPER, BEST, f"{BEST}, mask of 64 px")
    if "cut" in kinds:
        yield from (f"{PAPER}, cut by the border", f"{BEST}, cut by the border")
    if "network" in kinds:
        yield PREDICTION
    if not ablation:
        yield f"{BEST}, {FOUR}"
        if "network" in kinds:
            yield from NETWORKS


def study_of(record: Record) -> str | None:
    """The study that a record is of; None for what is no record of one."""
    name = record.get("study", record.get("bench"))
    return name if isinstance(name, str) and name in JUDGED else None


def parts_of(record: Record) -> list[str]:
    """What ``record`` judges; InputError where it does not say so."""
    name = study_of(record)
    if name is None:
        raise InputError(f"the record is of the study {shown(record.get('study'))}, expected one of {', '.join(JUDGED)}")
    try:
        return list(dict.fromkeys(JUDGED[name](record)))
    except (KeyError, TypeError) as error:
        raise InputError(f"the record of the study {name} lacks {error}, expected settings that say what it judges") from None


def fingerprint(record: Record) -> Fingerprint:
    """Of the method as it is, what ``record`` judges of it; numbers have five digits. Worked out once in a process."""
    parts = parts_of(record)
    for part in parts:
        if part not in _known:
            _known[part] = {what: float(f"{value:.5g}") for what, value in PARTS[part]().items()}
    return {part: dict(_known[part]) for part in parts}


def stamped(record: Record) -> Record:
    """The record with the fingerprint of the method as it is."""
    return {**record, KEY: fingerprint(record)}


def differences(record: Record, lacking: bool = True) -> list[str]:
    """What sets the method of ``record`` apart from the method as it is, a line a number; empty where nothing does.

    ``lacking`` : numbers that one of both lacks set them apart too.
    """
    parts_of(record)
    kept = record.get(KEY)
    if not isinstance(kept, dict):
        return [f"it has no {KEY}"]
    found = []
    for part, numbers in fingerprint(record).items():
        own = kept.get(part)
        own = own if isinstance(own, dict) else {}
        for what in dict.fromkeys((*numbers, *own)):
            then, now = own.get(what), numbers.get(what)
            if (lacking or None not in (then, now)) and not _alike(part, what, then, now):
                found.append(f"{part}: {what} {then}, now {now}")
    return found


def _alike(part: str, what: str, then: object, now: float | None) -> bool:
    if not isinstance(then, (int, float)) or now is None:
        return False
    tolerance = STAGED_TOLERANCES.get(what.split(": ")[-1], TOLERANCE) if part.startswith(STAGED) else TOLERANCE
    return abs(then - now) <= tolerance * abs(now)
