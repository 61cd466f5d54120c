"""Scenes that are refined independently of one another."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from ..errors import InputError, TsoError
from ..geometry.view import View
from ..optimisation.settings import Settings
from .clock import Clock
from .config import RefineConfig
from .result import RefineResult
from .run import run
from .scene import as_scene, as_views


@dataclass(frozen=True, eq=False)
class Batch:
    """Scenes (points, views); ``interrupted`` is an event that all processes see."""

    scenes: list[tuple[Any, Any]]
    config: RefineConfig
    interrupted: Any

    def work(self, work_of: Callable[[Settings, int, int], tuple[int, int]]) -> tuple[int, int]:
        """The sum of the scenes' work; a scene that cannot be read counts as nothing."""
        comparisons = points = 0
        for scene in self.scenes:
            try:
                views = 1 if isinstance(scene[1], View) else len(scene[1])
                of_scene = work_of(self.config.settings(views), views, len(scene[0]))
            except (TypeError, LookupError):
                continue
            comparisons, points = comparisons + of_scene[0], points + of_scene[1]
        return comparisons, points

    def refine(self, number: int) -> RefineResult | TsoError:
        """The result of the scene of that number, or the error that `refine` would have raised."""
        while True:
            try:
                result = self._refined(number)
            except TsoError as error:
                return error
            except KeyboardInterrupt:
                self.interrupted.set()
                continue
            if result.fit.stop_reason == "interrupted":
                self.interrupted.set()
            return result

    def _refined(self, number: int) -> RefineResult:
        points, masks = _points_and_views(self.scenes[number], number)
        clock = Clock(self.interrupted.is_set())
        with clock.phase("prepare"):
            scene = as_scene(points, as_views(masks), name=f"points of scene {number}")
        return run(scene, self.config.settings(len(scene.read)), clock, None, self._pause)

    def _pause(self, step: int, steps: int, loss: float) -> None:
        if self.interrupted.is_set():
            raise KeyboardInterrupt


def _points_and_views(scene: Any, number: int) -> tuple[Any, Any]:
    try:
        points, views = scene
    except (TypeError, ValueError):
        sized = hasattr(scene, "__len__")
        shown = f"{type(scene).__name__} of {len(scene)}" if sized else repr(scene)
        raise InputError(f"scene {number} is {shown}, expected (points, views)") from None
    return points, views
