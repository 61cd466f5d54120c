"""One refinement as a composition: examine, prepare, optimise, judge."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from ..cloud.cloud import ControlledCloud
from ..diagnosis.examine import Diagnosis, NoOverlapError, examine, explained
from ..diagnosis.explain import SIMILAR, agreement
from ..diagnosis.placement import require_plane_through
from ..geometry.arrays import Array
from ..optimisation.config import Settings
from ..optimisation.learned_start import beginning
from ..optimisation.loop import Parameters, Progress
from ..optimisation.optimise import optimise, weigh
from ..optimisation.problem import prepare
from ..pose.causes import find_move
from ..pose.move import Move, unmoved
from ..prior import LearnedPrior, named_prior
from .clock import Clock
from .depth_maps import fit_maps, move_with_maps
from .judge import judge
from .result import RefineResult
from .scene import RefineScene


def run(
    scene: RefineScene,
    settings: Settings,
    clock: Clock,
    network: Parameters | None = None,
    on_progress: Progress | None = None,
) -> RefineResult:
    """The result of a scene; ``network`` predicts its cloud in the network modes.

    Ctrl-C before the optimisation leaves the cloud as it is. Raises InputError where cloud and
    masks do not meet or cannot be used, and TsoError as `judge`.
    """
    with clock.phase("prepare"):
        prior = named_prior(settings.prior)
        cloud = scene.cloud.controlled(settings.points, scene.views)
    before = scene.views
    move, scene, diagnosis = _begun(scene, cloud, settings, prior, clock)
    given = scene.views
    if move.kind != "nothing":
        pairs = zip(before, given, strict=True)
        given = tuple(replace(view, known=after.known) for view, after in pairs)
    with clock.phase("prepare"):
        problem = prepare(cloud, scene.views, settings)
        require_plane_through(problem, settings.symmetry)
        weighed = weigh(problem, settings)
    idle = diagnosis.fits or bool(diagnosis.of_input and not settings.accept_doubtful)
    begin = None
    if settings.smooth and settings.steps and prior is not None and not idle:
        of_start = problem, weighed.weights, prior
        begin = clock.attempt("move", partial(beginning, *of_start), None)
    report = on_progress and _in_unit_of(problem.cloud, on_progress)
    steps = 0 if clock.interrupted or idle else settings.steps
    with clock.phase("optimise"):
        optimised = optimise(weighed, settings, steps, network, begin, report)
    if clock.interrupted:
        optimised = replace(optimised, interrupted=True)
    with clock.phase("judge"):
        of_run = weighed, optimised, given, move, diagnosis
        return judge(*of_run, settings, clock.seconds)


def check(scene: RefineScene, settings: Settings) -> tuple[Diagnosis, ControlledCloud, Move]:
    """What `run` finds before the shape is refined; raises InputError as it does."""
    clock = Clock()
    prior = named_prior(settings.prior)
    cloud = scene.cloud.controlled(settings.points, scene.views)
    move, _, diagnosis = _begun(scene, cloud, settings, prior, clock)
    if clock.interrupted:
        raise KeyboardInterrupt
    return diagnosis, cloud, move


def _begun(
    scene: RefineScene,
    cloud: ControlledCloud,
    settings: Settings,
    prior: LearnedPrior | None,
    clock: Clock,
) -> tuple[Move, RefineScene, Diagnosis]:
    """What moves as one first, the scene after it as its shape is refined, and its diagnosis."""

    def examined(scene: RefineScene) -> Diagnosis:
        # The network modes place their cloud themselves.
        of_scene = scene.read, scene.views, scene.assumptions, settings.mode == "points"
        return clock.attempt("prepare", partial(examine, cloud, *of_scene), Diagnosis(()))

    diagnosis = examined(scene)
    find = partial(_move, cloud, settings, diagnosis, clock)
    move, scene = move_with_maps(scene, cloud.control_points, settings, find)
    if move.kind != "nothing":
        diagnosis = examined(scene)
    elif move.growth:
        scene = scene.with_outlines(move.growth)
    if diagnosis.apart:
        raise NoOverlapError(diagnosis.after(scene.known), cloud)
    if settings.smooth:
        find_causes = partial(explained, diagnosis, cloud, scene.views, move, prior)
        diagnosis = clock.attempt("prepare", find_causes, diagnosis)
    scene = fit_maps(scene.without(diagnosis.hidden), cloud, settings, clock)
    return move, scene, diagnosis.after(scene.known)


def _move(
    cloud: ControlledCloud,
    settings: Settings,
    as_given: Diagnosis,
    clock: Clock,
    scene: RefineScene,
) -> Move:
    """What moves as one first, unless something that was found in the input is likelier."""
    freedom, views = settings.move, scene.views
    if freedom == "shape" and not settings.smooth:
        return unmoved(views, "the shape alone was asked for")
    find = partial(find_move, cloud.body, views, freedom, settings.keep)
    move = clock.attempt("place", find, unmoved(views, "interrupted"))
    suspects = [finding for finding in as_given.suspicious if finding.hypotheses]
    if move.kind == "nothing" or move.why_unsure or not suspects:
        return move
    says = f"perhaps {suspects[0].says} instead ({suspects[0].name})"
    # A mask that is flipped or upside down is met by a cloud that is turned the wrong way.
    if move.is_far and any(h.of_mask for finding in suspects for h in finding.hypotheses):
        return replace(move, why_unsure=says)
    # What has nothing to fit, and explains as much, is likelier than a move.
    least = agreement(cloud.control_points, scene.after(move).views) - SIMILAR
    if (freedom == "auto" or not move.explains) and suspects[0].score >= least:
        return unmoved(views, says)
    return move


def _in_unit_of(cloud: ControlledCloud, on_progress: Progress) -> Progress:
    """Reports points in the unit of the cloud."""

    def report(step: int, steps: int, loss: float, points: Array) -> None:
        on_progress(step, steps, loss, cloud.denormalise(points))

    return report
