"""Which method a record is of: it keeps what that method did to the shipped examples.

A record of another method than today's is not resumed, and no page may show it.
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
# Relative tolerances of two numbers. On one or two threads, in plain or compiled loops, with another BLAS or set of
# instructions they differ by 3e-4 at most. Where points move in stages the last bit of a start can choose other nodes, which
# more masks and steps amplify: there Chamfer distances differ by up to 0.014, displacements by up to 0.029.
TOLERANCE = 0.005
STAGED, STAGED_TOLERANCES = "points, best", {"Chamfer": 0.02, "moved": 0.04, "IoU": 0.01}

PAPER, BEST = "points, paper", "points, best"
FOUR = "four masks"
NETWORKS = tuple(f"{mode}, {preset}" for mode in ("encoder", "encoder-decoder", "latent") for preset in ("paper", "best"))
MASKS, PRINTED = "training on masks", "training on masks, printed affinity"
OTHERS = ("training on masks, plain projection", "training on masks, depth projection")
POINTS, MEAN = "training on points", "mean shape"
PICTURES, PREDICTION = "pictures", "prediction"
# Those of older records too.
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
"""Study -> the parts of the method that its record judges."""

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
    """The parts that ``record`` depends on; InputError where its settings do not say."""
    name = study_of(record)
    if name is None:
        raise InputError(f"the record is of the study {shown(record.get('study'))}, expected one of {', '.join(JUDGED)}")
    try:
        return list(dict.fromkeys(JUDGED[name](record)))
    except (KeyError, TypeError) as error:
        raise InputError(f"the record of the study {name} lacks {error}, expected settings that say what it judges") from None


def fingerprint(record: Record) -> Fingerprint:
    """The numbers of today's method that ``record`` depends on, five digits each; computed once in a process."""
    parts = parts_of(record)
    for part in parts:
        if part not in _known:
            _known[part] = {what: float(f"{value:.5g}") for what, value in PARTS[part]().items()}
    return {part: dict(_known[part]) for part in parts}


def stamped(record: Record) -> Record:
    """The record with the fingerprint of the method as it is."""
    return {**record, KEY: fingerprint(record)}


def differences(record: Record, lacking: bool = True) -> list[str]:
    """How the method of ``record`` differs from today's, a line a number; empty where it does not.

    ``lacking`` : a number that only one of the two has is a difference too.
    """
    parts_of(record)
    kept = record.get(KEY)
    if not isinstance(kept, dict):
        return [f"it has no {KEY}"]
    lines = []
    for part, numbers in fingerprint(record).items():
        earlier = kept.get(part)
        earlier = earlier if isinstance(earlier, dict) else {}
        for what in dict.fromkeys((*numbers, *earlier)):
            then, today = earlier.get(what), numbers.get(what)
            if (lacking or None not in (then, today)) and not _alike(part, what, then, today):
                lines.append(f"{part}: {what} {then}, now {today}")
    return lines


def _alike(part: str, what: str, then: object, today: float | None) -> bool:
    if not isinstance(then, (int, float)) or today is None:
        return False
    tolerance = STAGED_TOLERANCES.get(what.split(": ")[-1], TOLERANCE) if part.startswith(STAGED) else TOLERANCE
    return abs(then - today) <= tolerance * abs(today)
