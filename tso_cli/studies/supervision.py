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
    """Chamfer of each kind by category beside the paper's, and what holds of its claims."""
    categories = judged_categories(runs)
    names = list(dict.fromkeys(run["setting"] for run in runs))
    means = {name: mean_of(runs, name, categories) for name in names}
    ratio = means[MASKS] / means[POINTS]
    others = min(means[DISCRETISED], means[LIN])
    claims = [
        claim(
            "3D points and masks both teach more than the mean shape",
            max(means[POINTS], means[MASKS]) < means[MEAN_SHAPE],
            f"{means[POINTS]:.2f} and {means[MASKS]:.2f} against {means[MEAN_SHAPE]:.2f}"
            + "".join(
                f"; not {name.lower()} on {category}"
                for name in (POINTS, MASKS)
                for category in categories
                if chamfer_of(runs, name, category) >= chamfer_of(runs, MEAN_SHAPE, category)  # type: ignore[operator]
            ),
        ),
        claim(
            f"masks alone come within {CLOSE:g} times the Chamfer distance of 3D supervision",
            ratio <= CLOSE,
            f"{means[MASKS]:.2f} against {means[POINTS]:.2f}, ratio {ratio:.2f}; paper 2.69 against 2.25, 1.20",
        ),
        claim(
            "the continuous projection beats both discrete ones",
            means[MASKS] < others,
            f"{means[MASKS]:.2f} against {means[DISCRETISED]:.2f} discretised and {means[LIN]:.2f} with Lin et al.'s depth "
            "maps; paper 2.69 against 3.62 of Lin et al.",
        ),
    ]
    if MASKS_ALL in means:
        ratio = means[MASKS_ALL] / means[MASKS]
        claims.append(
            claim(
                f"one network for all categories is comparable with one for each (at most {COMPARABLE:g} times)",
                ratio <= COMPARABLE,
                f"{means[MASKS_ALL]:.2f} against {means[MASKS]:.2f}, ratio {ratio:.2f}; paper 3.13 against 2.69, 1.16",
            )
        )
    summary = {
        name: {"mean": means[name], **{category: chamfer_of(runs, name, category) for category in categories}} for name in names
    }
    return {"summary": summary, "paper": SUPERVISION, "notes": NOTES, "claims": claims}
