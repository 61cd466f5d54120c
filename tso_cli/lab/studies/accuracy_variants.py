"""The ways of refining that the study of accuracy compares."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from ...errors import TsoError
from ...network.model import BaseNetwork
from ...refinement import RefineConfig, RefineResult, refine, refine_batch
from ...refinement.presets import BEST, Stage
from .accuracy_cases import AccuracyCase


@dataclass(frozen=True)
class Variant:
    """One way of refining a case.

    Parameters
    ----------
    config : its settings. masks : how many of the case's views it sees.
    then : settings of points mode, to go on from what ``config`` gave; None to stop there.
    """

    config: RefineConfig = field(default_factory=RefineConfig)
    masks: int = 1
    then: RefineConfig | None = None


def _made(**changes: object) -> Variant:
    return Variant(RefineConfig(coarse_to_fine=replace(BEST, **changes)))  # type: ignore[arg-type]


PAPER, DEFAULT = "paper", "best"
NO_SYMMETRY, TWO_MASKS, FOUR_MASKS = "best, no symmetry", "best, two masks", "best, four masks"
COMBINED = "latent, then points"
BOTH_COMBINED = "encoder-decoder, then points"
POINTS = {
    PAPER: Variant(RefineConfig(preset="paper")),
    DEFAULT: Variant(),
    NO_SYMMETRY: Variant(RefineConfig(symmetry="none")),
    TWO_MASKS: Variant(masks=2),
    FOUR_MASKS: Variant(masks=4),
}
STEPS = {f"best, {steps} steps": Variant(RefineConfig(steps=steps)) for steps in (12, 144)}
NETWORK_MODES = ("encoder", "encoder-decoder", "latent")
NETWORK = {
    **POINTS,
    **{
        f"{mode}, {preset}": Variant(RefineConfig(mode, preset=preset)) for mode in NETWORK_MODES for preset in (PAPER, DEFAULT)
    },
    COMBINED: Variant(RefineConfig("latent"), then=RefineConfig()),
    BOTH_COMBINED: Variant(RefineConfig("encoder-decoder"), then=RefineConfig()),
}
# Adam's steps do not shrink with the gradient: at the preset's rate the cloud falls apart.
ADAM_RATE = 2e-3
ABLATION = {
    PAPER: POINTS[PAPER],
    DEFAULT: POINTS[DEFAULT],
    "no mirror plane": POINTS[NO_SYMMETRY],
    "no smoothing": _made(stages=tuple(replace(stage, smoothness=0.0) for stage in BEST.stages)),
    "one stage": _made(stages=(Stage(10.0, 3.0, fine_grid=True),)),
    "64 cells in the last stage too": _made(stages=tuple(replace(stage, fine_grid=False) for stage in BEST.stages)),
    "anchor by the whole cloud alone": _made(local_prior=False),
    "no anchor": _made(prior_weight=0.0, least_prior_weight=0.0),
    "anchor alike for all": _made(prior_decay=0.0),
    "anchor down to 30 where the start is far off": _made(least_prior_weight=30.0),
    "no bounded reach": _made(stages=tuple(replace(stage, robust_scale=1000.0) for stage in BEST.stages)),
    "what pixels do not show pulled back too": _made(use_resolvability=False),
    "Adam for each number": Variant(RefineConfig(learning_rate=ADAM_RATE, coarse_to_fine=replace(BEST, uniform_adam=False))),
    "Chamfer to the start added": Variant(RefineConfig(gamma=1e6)),
}
"""The default preset with one ingredient changed in each row, between the paper's and itself."""


def variants_of(kind: str, ablation: bool) -> dict[str, Variant]:
    """The variants that cases of that kind are refined with."""
    if ablation:
        return ABLATION
    return {"network": NETWORK, "other": {**POINTS, **STEPS}}.get(kind, POINTS)


def refined(cases: list[AccuracyCase], variant: Variant, device: str, network: BaseNetwork | None) -> list[RefineResult]:
    """The result of each case; networks and colours have no batch. Raises TsoError where a case cannot be refined."""
    if variant.config.mode != "points" or any(case.colours is not None for case in cases):
        return [alone(case, variant, device, network) for case in cases]
    problems = [(case.initial, case.views[: variant.masks]) for case in cases]
    results = []
    for result in refine_batch(problems, replace(variant.config, device=device)):
        if isinstance(result, TsoError):
            raise result
        results.append(uninterrupted(result))
    return results


def alone(case: AccuracyCase, variant: Variant, device: str, network: BaseNetwork | None) -> RefineResult:
    """The result of one case, refined by itself."""
    config, views = replace(variant.config, device=device), case.views[: variant.masks]
    if config.mode == "points":
        return uninterrupted(refine(case.initial, views, config=config, colours=case.colours))
    result = uninterrupted(refine(None, views, config=config, network=network, image=case.image))
    if variant.then is None:
        return result
    then = uninterrupted(refine(result.points, views, config=replace(variant.then, device=device)))
    return replace(then, iou_before=result.iou_before)


def uninterrupted(result: RefineResult) -> RefineResult:
    """The result; KeyboardInterrupt where the loop has swallowed Ctrl-C and kept its best."""
    if result.stop_reason == "interrupted":
        raise KeyboardInterrupt
    return result
