"""What a network learns from: 3D points, masks, or masks through projections other than the paper's."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from .figures import CATEGORIES, SUPERVISION, chamfer_of, claim, judged_categories, mean_of, sigma_sq
from .material import ALL
from .mean_shape import MEAN_SHAPE
from .other_projections import DEPTH, PLAIN
from .trained import Setting

NAME, STEPS = "supervision", 1000
REDUCED, FULL = CATEGORIES, CATEGORIES
POINTS, MASKS = "3D points", "masks"
DISCRETISED, LIN = "masks, discretised", "depth maps, Lin et al."
POINTS_ALL, MASKS_ALL = "3D points, all categories", "masks, all categories"
NOTES = {
    DISCRETISED: "points rounded to pixels in place of the Gaussians: BCE has no gradient, only the affinity loss moves points",
    LIN: "the same with the L1 loss of depth maps, upsampled by 5, of the supervising views; no pretraining, one network",
}
# The paper calls its mask-supervised scores close to those of 3D supervision, and its multi-category ones comparable.
CLOSE, COMPARABLE = 1.5, 1.25
# The same training comes out as far away another time: what is better by less is not told apart.
BETTER = 0.95


def settings(categories: Sequence[str]) -> list[Setting]:
    """The networks of the study, and the answer without one: each kind for each category, and two for all together."""
    found = []
    for category in categories:
        masks = {"supervision": "masks", "sigma_sq": sigma_sq(category)}
        found += [
            Setting(MEAN_SHAPE, category, constant=True),
            Setting(POINTS, category, {"supervision": "points"}),
            Setting(MASKS, category, masks),
            Setting(DISCRETISED, category, masks, PLAIN),
            Setting(LIN, category, masks, DEPTH),
        ]
    if len(categories) > 1:
        found += [Setting(POINTS_ALL, ALL, {"supervision": "points"}), Setting(MASKS_ALL, ALL, {"supervision": "masks"})]
    return found


def conclude(runs: list[dict[str, Any]]) -> dict[str, Any]:
    """Chamfer of each kind by category beside the paper's, and what holds of its claims in every category."""
    categories = judged_categories(runs)
    names = list(dict.fromkeys(run["setting"] for run in runs))
    values = {name: {category: chamfer_of(runs, name, category) for category in categories} for name in names}

    def judged(text: str, first: str, others: Sequence[str], factor: float = BETTER, paper: str = "") -> dict[str, Any]:
        """Whether ``first`` is at most ``factor`` times each of the ``others`` in every category."""
        holds, parts = True, []
        for category in categories:
            own = [values[name][category] for name in (first, *others)]
            under = None not in own and all(own[0] <= factor * other for other in own[1:])  # type: ignore[operator]
            holds &= under
            told = " against ".join([_shown(own[0]), " and ".join(map(_shown, own[1:]))])
            parts.append(f"{category} {told}{'' if under else ', not there'}")
        return claim(text, holds, "; ".join(parts) + (f"; paper {paper}" if paper else ""))

    more = f"teach more than the mean shape, by {1.0 - BETTER:.0%} or more"
    claims = [judged(f"{name} {more}", name, [MEAN_SHAPE]) for name in (POINTS, MASKS)]
    claims += [
        judged(
            f"masks alone come within {CLOSE:g} times the Chamfer distance of 3D supervision",
            MASKS,
            [POINTS],
            CLOSE,
            "1.20 times in the mean",
        ),
        judged(
            f"the continuous projection beats the discretised one and Lin et al.'s, by {1.0 - BETTER:.0%} or more",
            MASKS,
            [DISCRETISED, LIN],
            paper="2.69 against 3.62 of Lin et al. in the mean",
        ),
    ]
    if MASKS_ALL in values:
        claims.append(
            judged(
                f"one network for all categories is comparable with one for each (at most {COMPARABLE:g} times)",
                MASKS_ALL,
                [MASKS],
                COMPARABLE,
                "1.16 times in the mean",
            )
        )
    summary = {name: {"mean": mean_of(runs, name, categories), **own} for name, own in values.items()}
    return {"summary": summary, "paper": SUPERVISION, "notes": NOTES, "claims": claims}


def _shown(value: float | None) -> str:
    return "none" if value is None else f"{value:.2f}"
