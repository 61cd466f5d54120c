"""One refinement as a composition: examine, prepare, verify, optimise, judge."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from ..cloud.cloud import ControlledCloud
from ..diagnosis.examine import Diagnosis, NoOverlapError, examine, explained
from ..diagnosis.explain import Margin
from ..diagnosis.placement import require_plane_through
from ..diagnosis.verification import verify_hypotheses
from ..geometry.arrays import Array
from ..optimisation.learned_start import beginning
from ..optimisation.loop import Parameters, Progress
from ..optimisation.optimise import optimise, weigh
from ..optimisation.problem import prepare
from ..optimisation.settings import Settings
from ..pose.causes import find_move
from ..pose.move import Move, unmoved
from ..prior import named_prior
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
    given = scene.views
    move, scene = _moved(scene, cloud, settings, clock)
    if move.kind == "nothing":
        # Also with outlines that are corrected.
        given = scene.views
    diagnosis = _diagnosed(scene, cloud, move, settings, clock)
    with clock.phase("prepare"):
        if diagnosis.hidden:
            scene = scene.without(diagnosis.hidden)
            pairs = zip(given, scene.views, strict=True)
            given = tuple(replace(view, known=seen.known) for view, seen in pairs)
    scene, diagnosis = _fitted(scene, cloud, diagnosis, settings, clock)
    with clock.phase("prepare"):
        problem = prepare(cloud, scene.views, settings)
        require_plane_through(problem, settings.symmetry)
        settings = settings.for_observations(problem.observations)
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
    named_prior(settings.prior)
    cloud = scene.cloud.controlled(settings.points, scene.views)
    move, scene = _moved(scene, cloud, settings, clock)
    diagnosis = _diagnosed(scene, cloud, move, settings, clock)
    scene, diagnosis = _fitted(scene, cloud, diagnosis, settings, clock)
    if clock.interrupted:
        raise KeyboardInterrupt
    return diagnosis, cloud, move


def _moved(
    scene: RefineScene, cloud: ControlledCloud, settings: Settings, clock: Clock
) -> tuple[Move, RefineScene]:
    """What moves as one first, and the scene after it without wrong depth maps."""
    find = partial(_move, cloud=cloud, settings=settings, clock=clock)
    if not settings.smooth:
        # Depth maps are refused later.
        move = find(scene)
        return move, scene.after(move)
    move, placed = move_with_maps(scene, cloud.control_points, settings.move, find)
    return move, placed.with_outlines(move.growth) if move.growth else placed


def _fitted(
    scene: RefineScene,
    cloud: ControlledCloud,
    diagnosis: Diagnosis,
    settings: Settings,
    clock: Clock,
) -> tuple[RefineScene, Diagnosis]:
    """The scene with depth maps along z, and the diagnosis with what was fitted."""
    scene, found = fit_maps(scene, cloud, settings, clock)
    return scene, replace(diagnosis, notes=(*found, *diagnosis.notes))


def _move(scene: RefineScene, cloud: ControlledCloud, settings: Settings, clock: Clock) -> Move:
    """What moves as one first."""
    asked = settings.move
    body, views, keep = cloud.body, scene.views, settings.keep
    if asked == "shape" and not settings.smooth:
        return unmoved(views, "the shape alone was asked for")
    find = partial(find_move, body, views, asked, keep)
    move = clock.attempt("place", find, unmoved(views, "interrupted"))
    if move.kind == "nothing" or move.why_unsure:
        return move
    with clock.phase("place"):
        as_given, moved = (
            _examined_anyhow(some, cloud, settings) for some in (scene, scene.after(move))
        )
    likelier = asked == "auto" or not move.explains
    for one in (*as_given.suspicious, *(as_given.weak if asked == "auto" else ())):
        says = f"perhaps {one.says} instead ({one.name})"
        # A mask that is flipped or upside down is met by a cloud that is turned the wrong way.
        if move.is_far and any(hypothesis.of_mask for hypothesis in one.hypotheses):
            return replace(move, why_unsure=says)
        # What has nothing to fit, and explains as much, is likelier than a move.
        explained = moved.explanation.as_given if moved.explanation else 0.0
        if likelier and one.hypotheses and one.score >= explained - Margin.SIMILAR:
            return unmoved(scene.views, says)
    return move


def _in_unit_of(cloud: ControlledCloud, on_progress: Progress) -> Progress:
    """Reports points in the unit of the cloud."""

    def report(step: int, steps: int, loss: float, points: Array) -> None:
        on_progress(step, steps, loss, cloud.denormalise(points))

    return report


def _examined(scene: RefineScene, cloud: ControlledCloud, settings: Settings) -> Diagnosis:
    # The network modes place their cloud themselves.
    hypotheses = settings.mode == "points"
    of_scene = scene.read, scene.views, scene.assumptions, scene.known
    return examine(cloud, *of_scene, hypotheses=hypotheses)


def _diagnosed(
    scene: RefineScene, cloud: ControlledCloud, move: Move, settings: Settings, clock: Clock
) -> Diagnosis:
    """What may be wrong with a scene, after the ``move``."""
    with clock.phase("prepare"):
        diagnosis = _examined(scene, cloud, settings)
    if move.fits or move.causes:
        # What nearly nothing contradicts needs no weak explanation.
        diagnosis = replace(diagnosis, weak=())
    of_scene = cloud.body, scene.read, scene.assumptions
    diagnosis = clock.attempt(
        "prepare", partial(verify_hypotheses, diagnosis, *of_scene), diagnosis
    )
    if not settings.smooth:
        return diagnosis
    find_causes = partial(explained, diagnosis, cloud.body, scene.views, move)
    return clock.attempt("prepare", find_causes, diagnosis)


def _examined_anyhow(scene: RefineScene, cloud: ControlledCloud, settings: Settings) -> Diagnosis:
    """The diagnosis, also where cloud and masks do not meet."""
    try:
        return _examined(scene, cloud, settings)
    except NoOverlapError as error:
        return error.diagnosis
