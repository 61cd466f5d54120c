"""The ways of refining that studies compare."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Final

from tso_cli.errors import TsoError
from tso_cli.io.shipped import NO_PRIOR
from tso_cli.network.model import BaseNetwork
from tso_cli.optimisation.presets import Mode
from tso_cli.refinement import RefineConfig, RefineResult, refine, refine_batch

from ..study import uninterrupted
from .cases import Case


@dataclass(frozen=True)
class Variant:
    """One way of refining a case.

    config : settings. masks : how many masks of the case are seen.
    then : settings of a second refinement, in points mode, which starts from the result.
    """

    config: RefineConfig = field(default_factory=RefineConfig)
    masks: int = 1
    then: RefineConfig | None = None


PAPER: Final = "paper"
DEFAULT: Final = "best"
NO_SYMMETRY, TWO_MASKS, FOUR_MASKS = "best, no symmetry", "best, two masks", "best, four masks"
BY_MASKS = (DEFAULT, TWO_MASKS, FOUR_MASKS)
"""The default preset with one, two and four masks."""
# The paper's method leaves nothing as it was.
POINTS = {
    PAPER: Variant(RefineConfig(preset="paper", accept_doubtful=True)),
    DEFAULT: Variant(),
    NO_SYMMETRY: Variant(RefineConfig(symmetry="none")),
    TWO_MASKS: Variant(masks=2),
    FOUR_MASKS: Variant(masks=4),
}
FIRST_MODES: tuple[Mode, ...] = ("latent", "encoder-decoder")
COMBINED = {
    f"{mode}, then points": Variant(
        RefineConfig(mode=mode, accept_doubtful=True), then=RefineConfig()
    )
    for mode in FIRST_MODES
}
ABLATION = {
    PAPER: POINTS[PAPER],
    DEFAULT: POINTS[DEFAULT],
    "no mirror plane": POINTS[NO_SYMMETRY],
    "no learned prior": Variant(RefineConfig(prior=NO_PRIOR)),
    "one step": Variant(RefineConfig(steps=1)),
}
"""The default preset with one ingredient changed in each row, below the paper's and itself."""


def with_prior(variants: Mapping[str, Variant], prior: str) -> dict[str, Variant]:
    """The ``variants`` with this learned prior, wherever the default preset moves points.

    A variant that has chosen its prior keeps it.
    """

    def chosen(config: RefineConfig) -> RefineConfig:
        takes_one = (config.preset, config.mode) == (DEFAULT, "points") and config.prior is None
        return replace(config, prior=prior) if takes_one else config

    return {
        name: replace(
            variant, config=chosen(variant.config), then=variant.then and chosen(variant.then)
        )
        for name, variant in variants.items()
    }


def refined(
    cases: list[Case], variant: Variant, network: BaseNetwork | None = None
) -> list[RefineResult]:
    """The result of each case; TsoError where a case cannot be refined."""
    # Networks have no batch.
    if variant.config.mode != "points":
        return [alone(case, variant, network) for case in cases]
    problems = [(case.initial, case.views[: variant.masks]) for case in cases]
    results = []
    for result in refine_batch(problems, variant.config):
        uninterrupted(result)
        if isinstance(result, TsoError):
            raise result
        results.append(result)
    return results


def alone(case: Case, variant: Variant, network: BaseNetwork | None) -> RefineResult:
    """The result of one case, refined by itself."""
    config, views = variant.config, case.views[: variant.masks]
    if config.mode == "points":
        return uninterrupted(refine(case.initial, views, config=config))
    result = uninterrupted(refine(None, views, config=config, network=network, image=case.image))
    if variant.then is None:
        return result
    then = uninterrupted(refine(result.points, views, config=variant.then))
    return replace(then, fit=replace(then.fit, iou_before=result.fit.iou_before))
