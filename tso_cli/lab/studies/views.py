"""How many masks of each object should supervise a step."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..charts.bars import Rows
from ..study import Cases, Record, claim
from .judging import MEAN_SHAPE
from .trained import Comparison, Setting, chamfers, masks, trained_study

COUNTS = ("1", "2", "3", "4", "5", "6", "8")
PAPER = {
    "airplane": dict(zip(COUNTS, (2.40, 2.02, 2.0, 2.0, 1.98, 1.99, 2.01), strict=True)),
    "car": dict(zip(COUNTS, (3.47, 1.68, 1.65, 1.65, 1.68, 1.65, 1.68), strict=True)),
    "chair": dict(zip(COUNTS, (4.53, 4.41, 4.35, 4.36, 4.43, 4.42, 4.56), strict=True)),
}
# The paper's values for two masks and more lie within 5 % of each other.
CONSTANT = 1.1


def _names(count: str) -> list[str]:
    """The networks for ``count`` masks: three for one and for two, the comparison that the study is about."""
    return [f"V = {count}" + f", seed + {repeat}" * (repeat > 0) for repeat in range(3 if count in "12" else 1)]


def settings(categories: Sequence[str]) -> list[Setting]:
    """For each category the networks for each number of masks, beside the mean shape."""
    networks = []
    for category in categories:
        networks.append(Setting(MEAN_SHAPE, category, constant=True))
        for count in COUNTS:
            changes = masks(category, views=int(count))
            networks += [Setting(name, category, changes, repeat=repeat) for repeat, name in enumerate(_names(count))]
    return networks


def conclude(cases: Cases) -> Record:
    """Chamfer by category and number of masks (the mean over seeds) beside the paper's, and which of its claims hold."""
    values = chamfers(cases)
    constant = values[MEAN_SHAPE]
    seeds = {category: {count: [values[name][category] for name in _names(count)] for count in COUNTS} for category in constant}
    summary = {name: {count: float(np.mean(one)) for count, one in by_count.items()} for name, by_count in seeds.items()}
    gains, spreads, largest = [], {}, {}
    for category, means in summary.items():
        one, two = ("/".join(f"{value:.2f}" for value in seeds[category][count]) for count in "12")
        paper = f", paper {_gain(PAPER[category])}" if category in PAPER else ""
        gains.append(f"{category} {one} to {two} ({_gain(means)}{paper})")
        more = [means[count] for count in COUNTS[1:]]
        spreads[category] = max(more) / min(more)
        largest[category] = max(means.values())
    claims = [
        claim(
            "two masks of each object are better than one, whatever the seed",
            all(max(by_count["2"]) < min(by_count["1"]) for by_count in seeds.values()),
            ", ".join(gains),
        ),
        claim(
            f"more than two change little (largest at most {CONSTANT:g} times the smallest)",
            max(spreads.values()) <= CONSTANT,
            ", ".join(f"{name} {value:.2f} times" for name, value in spreads.items()),
        ),
        claim(
            "masks teach more than the mean shape",
            all(value < constant[name] for name, value in largest.items()),
            ", ".join(
                f"{name} {value:.2f} at most against {constant[name]:.2f}{', not there' * (value >= constant[name])}"
                for name, value in largest.items()
            ),
        ),
    ]
    return {"summary": summary, "constant": constant, "paper": PAPER, "claims": claims}


def _gain(values: dict[str, float]) -> str:
    """By how much two masks change the distance of one."""
    return f"{100.0 * (values['2'] / values['1'] - 1.0):+.0f} %"


def rows(record: Record) -> Rows:
    """Chamfer by number of masks, ours and the paper's."""
    shown = {}
    for category, means in record["summary"].items():
        shown[category] = {**means, MEAN_SHAPE: record["constant"][category]}
        if category in record["paper"]:
            shown[f"{category}, paper"] = record["paper"][category]
    return {"masks": shown}


STUDY = trained_study(
    name="views",
    about="Networks trained with 1, 2, 3, 4, 5, 6 and 8 masks of each object a step; of 1 and 2 three networks each, which "
    "differ in their seed alone. Reduced size: cars alone, 2,000 steps of 8.",
    reading="In the paper the second mask of each object gains a lot, and more gain nothing. Here the second gains nothing "
    "either. One mask a step is another one at every step, so that over the training every object is seen from all 24 sides: "
    "that may be why.",
    comparison=Comparison(2000, ("car",), settings),
    conclude=conclude,
    rows=rows,
)
