"""lambda, the weight of the affinity loss, in both forms of the loss."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from .figures import LAMBDA, claim, judged_categories, mean_of, sigma_sq
from .trained import Setting

NAME, STEPS = "lambda", 500
REDUCED, FULL = ("chair",), ("chair",)
FORMS = ("points", "paper")
WEIGHTS = (0.0, 5e-5, 1e-4, 5e-4, 0.01, 0.1, 0.5, 1.0, 5.0)
NONE = "none"


def settings(categories: Sequence[str]) -> list[Setting]:
    """A network for each weight and form; without the loss the form makes no difference."""
    found = []
    for category in categories:
        masks = {"supervision": "masks", "sigma_sq": sigma_sq(category)}
        found.append(Setting(NONE, category, {**masks, "affinity_weight": 0.0}))
        for form in FORMS:
            for weight in WEIGHTS[1:]:
                found.append(Setting(_name(form, weight), category, {**masks, "affinity_weight": weight, "affinity": form}))
    return found


def conclude(runs: list[dict[str, Any]]) -> dict[str, Any]:
    """Chamfer by form and weight, the mean over categories, beside the paper's; and whether 1 is the best weight."""
    categories = judged_categories(runs)
    summary: dict[str, dict[str, float]] = {
        form: {f"{weight:g}": mean_of(runs, _name(form, weight), categories) for weight in WEIGHTS} for form in FORMS
    }
    claims = []
    # The paper tried it on chairs.
    for form, values in summary.items() if categories == ["chair"] else ():
        three = {weight: values[f"{weight:g}"] for weight in LAMBDA}
        claims.append(
            claim(
                f"of 0.5e-4, 1e-4 and 5e-4, lambda = 1e-4 is the best (form {form!r})",
                min(three, key=lambda weight: three[weight]) == 1e-4,
                f"{', '.join(f'{value:.2f}' for value in three.values())}; paper 4.63, 4.42, 5.3; best of all here: "
                f"lambda = {min(values, key=lambda weight: values[weight])}, {min(values.values()):.2f}",
            )
        )
    paper = {f"{weight:g}": value for weight, value in LAMBDA.items()}
    return {"summary": summary, "paper": {"chair": paper} if claims else {}, "claims": claims}


def _name(form: str, weight: float) -> str:
    return f"{form}, {weight:g}" if weight else NONE
