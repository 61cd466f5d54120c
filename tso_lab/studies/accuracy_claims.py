"""The targets of the study of accuracy, and whether its cases meet them."""

from __future__ import annotations

import numpy as np

from ..study import Cases, Record, claim
from .cases import LEVELS
from .refining import DEFAULT, MASKS, NO_SYMMETRY, PAPER, TWO_MASKS
from .summary import grouped, interval, ratio_of_means, ratios_of

ALL = "all"
"""All categories of a kind together."""
# Kind -> category -> variant -> mean Chamfer after / mean Chamfer before that is aimed at.
AIMS = {
    "other": {
        "chair": {DEFAULT: 0.50, TWO_MASKS: 0.40},
        "airplane": {DEFAULT: 0.40, TWO_MASKS: 0.30},
        "car": {DEFAULT: 0.75, TWO_MASKS: 0.68},
    },
    "near": {"airplane": {DEFAULT: 0.75}},
    "right": {ALL: {DEFAULT: 1.01}},
    "network": {ALL: {DEFAULT: 0.80}},
}
# Aims for starts near the truth: mean and worst ratio.
NEAR_MEAN, NEAR_WORST = 1.00, 1.05
# A start counts as near up to this many times its category's level.
NEAR_ENOUGH = 1.5
# Aims for harm: the share of cases stays below this, and the worst ratio is at most this.
WORSE_SHARE, WORST = 0.02, 1.05
# The share of all cases of the default preset that may have a ratio over `WORST`.
CLEARLY_WORSE_SHARE = 0.01


def claims(cases: Cases) -> list[Record]:
    """The targets, whether they are met, and the figures; only of kinds that were studied."""
    kinds = grouped(cases, "kind")
    answers = [aim for kind in AIMS if kind in kinds for aim in _aims(kind, kinds[kind])]
    if "other" in kinds:
        answers.append(_beyond_the_paper(kinds["other"]))
    answers += _stays_right(grouped(kinds.get("near", []), "category"))
    answers += [_rarely_clearly_worse(kind, group, WORSE_SHARE) for kind, group in kinds.items()]
    answers.append(_rarely_clearly_worse("all starts", cases, CLEARLY_WORSE_SHARE))
    # A start at the floor can only get worse.
    starts = {kind: group for kind, group in kinds.items() if kind != "right"}
    if starts:
        groups = {
            f"{kind}, {variant}": ratios_of(group, variant)
            for kind, group in starts.items()
            for variant in MASKS
        }
        # Two and four masks hardly ever do harm; they must not hide the harm of one mask.
        one_mask = np.concatenate([ratios_of(group, DEFAULT) for group in starts.values()])
        what = "points mode, all starts, with one, two and four masks"
        answers.append(_rarely_worse(what, groups, float((one_mask > 1.0).mean())))
    return answers


def _aims(kind: str, cases: Cases) -> list[Record]:
    """Ratios of means; the mean of ratios says how much single cases differ from them."""
    categories = {**grouped(cases, "category"), ALL: cases}
    answers = []
    for category in (name for name in AIMS[kind] if name in categories):
        group = categories[category]
        against = [f"the paper's preset {_ratio_after(group, PAPER):.3f}"]
        if all("bound" in case for case in group):
            bound = ratio_of_means(group, (case["bound"] for case in group))
            against.append(f"bound of one mask {bound:.2f}")
        floor = ratio_of_means(group, (case["before"]["floor"] for case in group))
        against.append(f"sampling floor {floor:.2f}")
        for variant, aim in AIMS[kind][category].items():
            ratio, mean_ratio = _ratio_after(group, variant), ratios_of(group, variant).mean()
            text = f"{kind}, {category}: {variant}: ratio of means at most {aim:.2f}"
            found = f"{ratio:.3f}, mean of ratios {mean_ratio:.3f}; {', '.join(against)}"
            answers.append(claim(text, ratio <= aim, found))
    return answers


def _ratio_after(cases: Cases, variant: str) -> float:
    return ratio_of_means(cases, (case["variants"][variant]["chamfer"] for case in cases))


def _beyond_the_paper(cases: Cases) -> Record:
    """Whole 95 % intervals, over shapes, of the difference of the mean ratios."""
    texts, highest = [], []
    for category, group in sorted(grouped(cases, "category").items()):
        for variant in (DEFAULT, NO_SYMMETRY, TWO_MASKS):
            gained = ratios_of(group, variant) - ratios_of(group, PAPER)
            highest.append(interval([case["shape"] for case in group], gained)[1])
            texts.append(f"{category}, {variant} {gained.mean():+.3f}, at most {highest[-1]:+.3f}")
    text = "every column lies below the paper's preset in every category"
    return claim(f"{text} (95 % interval over shapes)", max(highest) < 0.0, "; ".join(texts))


def _stays_right(by_category: dict[str, Cases]) -> list[Record]:
    answers = []
    for category, level in LEVELS["near"].items():
        most = NEAR_ENOUGH * level
        near = [case for case in by_category.get(category, []) if case["before"]["chamfer"] <= most]
        if near:
            ratios = ratios_of(near, DEFAULT)
            text = f"{category} near the truth: mean ratio at most {NEAR_MEAN:.2f}"
            text += f", worst at most {NEAR_WORST:.2f}"
            holds = ratios.mean() <= NEAR_MEAN and ratios.max() <= NEAR_WORST
            figures = f"{ratios.mean():.3f}, {ratios.max():.3f}; {len(near)} cases"
            answers.append(
                claim(text, holds, f"{figures} with Chamfer x1000 up to {1e3 * most:.1f}")
            )
    return answers


def _rarely_worse(what: str, groups: dict[str, np.ndarray], share: float = 0.0) -> Record:
    """``groups`` : label -> ratios; ``share`` : of a group that the others may not hide."""
    ratios = np.concatenate(list(groups.values()))
    of_all = float((ratios > 1.0).mean())
    figures = [f"{100.0 * of_all:.1f} % of {len(ratios)}, worst {ratios.max():.3f}"]
    for name, values in groups.items():
        figures.append(f"{name}: {(values > 1.0).sum()} of {len(values)}, {values.max():.3f}")
    text = f"{what}: under {100.0 * WORSE_SHARE:g} % of cases are made worse"
    text += f", none by over {100.0 * (WORST - 1.0):.0f} %"
    holds = max(share, of_all) < WORSE_SHARE and ratios.max() <= WORST
    return claim(text, holds, "; ".join(figures))


def _rarely_clearly_worse(kind: str, cases: Cases, limit: float) -> Record:
    """Of one kind of start, or all, with one mask; the share must be under the ``limit``."""
    ratios = ratios_of(cases, DEFAULT)
    share = float((ratios > WORST).mean())
    text = f"{kind}: {DEFAULT}: under {100.0 * limit:g} % of cases become worse by over "
    found = f"{100.0 * share:.1f} % of {len(ratios)}, worst {ratios.max():.3f}"
    return claim(f"{text}{100.0 * (WORST - 1.0):.0f} %", share < limit, found)
