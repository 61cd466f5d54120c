"""Means and claims of the study of the variants."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

VARIANTS = ("encoder", "encoder-decoder", "points")
LETTERS = {"before": "before", "encoder": "E", "encoder-decoder": "E and D", "points": "p"}
"""What the paper calls them: which parameters move."""
PROTOCOLS = ("capnet", "plain")
# Forward, backward and their sum, x1000: the paper's table of test-stage optimisation.
PAPER = {
    "before": (2.45, 2.19, 4.64),
    "encoder": (2.29, 2.14, 4.43),
    "encoder-decoder": (2.28, 2.09, 4.37),
    "points": (2.36, 2.13, 4.49),
}
# Resampled sets of shapes behind an interval, which holds 95 % of the ratios that they give.
RESAMPLED, INTERVAL = 4000, (2.5, 97.5)
KEPT = 1.01
"""Up to this ratio of distances after and before, what the picture does not show counts as kept."""

Summary = dict[str, Any]


def summarise(cases: list[dict[str, Any]]) -> Summary:
    """Means over the cases of each category, and over all of them as "all"."""
    categories = sorted({case["category"] for case in cases})
    groups = {name: [case for case in cases if case["category"] == name] for name in categories}
    return {name: _group(own) for name, own in {**groups, "all": cases}.items()}


def _group(cases: list[dict[str, Any]]) -> Summary:
    shapes = [case["shape"] for case in cases]
    return {
        "shapes": len(set(shapes)),
        "cases": len(cases),
        "visible_share": float(np.mean([case["visible_share"] for case in cases])),
        "iou": {name: float(np.mean([case["iou"][name] for case in cases])) for name in ("before", *VARIANTS)},
        "median_seconds": {name: float(np.median([case["seconds"][name] for case in cases])) for name in VARIANTS},
        **{
            protocol: _distances([case[protocol] for case in cases], [case["shape"] for case in cases])
            for protocol in PROTOCOLS
        },
    }


def _distances(cases: list[dict[str, dict[str, float | None]]], shapes: list[str]) -> Summary:
    """Before and each variant: means of the distances; and of each variant what became of them.

    ``shapes`` names the shape of each case: ``interval`` is that of the ratio of the means over sets of shapes drawn anew,
    with their views, from those there are.
    """

    def values(name: str, key: str) -> list[float]:
        return [value for case in cases if (value := case[name][key]) is not None]

    def sums(name: str) -> np.ndarray:
        return np.array(values(name, "forward")) + np.array(values(name, "backward"))

    summary: Summary = {}
    for name in ("before", *VARIANTS):
        own: Summary = {}
        for key in ("forward", "backward", "visible", "occluded"):
            found = values(name, key)
            own[key] = float(np.mean(found)) if found else None
        own["chamfer"] = float(sums(name).mean())
        if name != "before":
            ratios = sums(name) / sums("before")
            before = summary["before"]
            own["ratio_of_means"] = own["chamfer"] / before["chamfer"]
            own["interval"] = _interval(sums(name), sums("before"), shapes)
            for key in ("visible", "occluded"):
                own[f"{key}_ratio"] = own[key] / before[key] if before[key] else None
            own["mean_ratio"] = float(ratios.mean())
            own["median_ratio"] = float(np.median(ratios))
            own["worst_ratio"] = float(ratios.max())
            own["worse"] = int((ratios > 1.0).sum())
        summary[name] = own
    return summary


def _interval(after: np.ndarray, before: np.ndarray, shapes: list[str]) -> list[float]:
    """95 % interval of the ratio of the means over shapes drawn anew with replacement."""
    _, of = np.unique(shapes, return_inverse=True)
    totals = np.stack([np.bincount(of, values) for values in (after, before)])
    drawn = np.random.default_rng(0).integers(totals.shape[1], size=(RESAMPLED, totals.shape[1]))
    ratios = totals[0][drawn].sum(1) / totals[1][drawn].sum(1)
    low, high = np.percentile(ratios, INTERVAL)
    return [float(low), float(high)]


def claims(summary: Summary) -> list[dict[str, Any]]:
    """What the paper says of its table, whether it holds here over all cases and in every category, and the figures.

    All are judged under the paper's protocol, on ratios of the means after and before; the first one, over all, on the whole
    interval of each ratio, so that what might be chance does not count.
    """

    def ratios(of: Summary, key: str) -> dict[str, float]:
        own = of["capnet"]
        return {name: 1.0 if own[name][key] is None else own[name][key] for name in VARIANTS}

    def gained(of: Summary) -> dict[str, float]:
        return {name: of["iou"][name] - of["iou"]["before"] for name in VARIANTS}

    def lowered(of: Summary) -> bool:
        if of is summary["all"]:
            return all(of["capnet"][name]["interval"][1] < 1.0 for name in VARIANTS)
        return all(ratio < 1.0 for ratio in ratios(of, "ratio_of_means").values())

    def in_order(of: Summary) -> bool:
        total = ratios(of, "ratio_of_means")
        return total["encoder-decoder"] < total["encoder"] < total["points"]

    def detailed(of: Summary) -> bool:
        visible, more = ratios(of, "visible_ratio"), gained(of)
        return all(visible[name] < visible["encoder"] and more[name] > more["encoder"] for name in VARIANTS[1:])

    def kept(of: Summary) -> bool:
        return all(ratio <= KEPT for ratio in ratios(of, "occluded_ratio").values())

    def nearer(of: Summary) -> bool:
        return all(ratio < 1.0 for ratio in ratios(of, "visible_ratio").values())

    def judged(text: str, holds: Callable[[Summary], bool], found: str) -> dict[str, Any]:
        fails = [category for category, own in summary.items() if not holds(own)]
        return {"claim": text, "holds": not fails, "found": found + (f"; not on {', '.join(fails)}" if fails else "")}

    every = summary["all"]
    total = _changes(ratios(every, "ratio_of_means"))
    ends = ", ".join(
        f"{LETTERS[name]} {' to '.join(f'{100.0 * (end - 1.0):+.1f}' for end in every['capnet'][name]['interval'])} %"
        for name in VARIANTS
    )
    visible = f"visible points {_changes(ratios(every, 'visible_ratio'))}"
    ious = ", ".join(f"{LETTERS[name]} {more:+.3f}" for name, more in gained(every).items())
    return [
        judged("every variant lowers the mean Chamfer distance", lowered, f"{total}; 95 % intervals over shapes {ends}"),
        judged("E and D together gain most, p alone least", in_order, total),
        judged(
            "what the picture does not show is kept",
            kept,
            f"forward distance of occluded points {_changes(ratios(every, 'occluded_ratio'))}",
        ),
        judged("what the picture shows comes nearer to the truth", nearer, f"forward distance of {visible}"),
        judged("E alone misses detail that the other two gain", detailed, f"{visible}; IoU {ious}"),
    ]


def _changes(ratios: dict[str, float]) -> str:
    return ", ".join(f"{LETTERS[name]} {100.0 * (ratio - 1.0):+.1f} %" for name, ratio in ratios.items())
