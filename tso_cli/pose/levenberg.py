"""Levenberg-Marquardt steps of many placements at once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..geometry.arrays import Array
from .placement import SCALES, SHIFT, TURN, UNKNOWNS, OfPlacements, Placements, Rows

# The linear model holds for steps up to this: radians, logarithms, and sizes of the cloud.
LARGEST_STEP = 0.4
# How many residuals are independent of each other. A silhouette has many more pixels, but what a
# wrong shape adds or lacks spans long pieces of its contour.
INDEPENDENT = 30.0
# What a misfit does not fall below: that of a cloud whose points lie within a cell.
LEAST_MISFIT = 3e-3
# A descent ends where a step gains less, in units of the posterior's logarithm.
ENOUGH = 0.1
# The damping, relative to the diagonal of the normal matrix; what it is multiplied by after a step
# that lowers the misfit, and after one that does not; and what is added for unknowns that no
# residual depends on, relative to the largest diagonal element.
FIRST_DAMPING, LEAST_DAMPING, MOST_DAMPING = 1e-3, 1e-6, 10.0
FALL, RISE, ABSOLUTE_DAMPING = 0.2, 10.0, 1e-9


@dataclass(frozen=True, eq=False)
class System(OfPlacements):
    """A sum of squares at P placements, and its linear model."""

    value: Array  # [P]
    normal: Array  # [P, 17, 17]
    gradient: Array  # [P, 17], downhill

    @classmethod
    def empty(cls, count: int) -> System:
        square = np.zeros((count, UNKNOWNS, UNKNOWNS))
        return cls(np.zeros(count), square, np.zeros((count, UNKNOWNS)))

    def __add__(self, other: System) -> System:
        pairs = zip(self.arrays().values(), other.arrays().values(), strict=True)
        return System(*(first + second for first, second in pairs))

    def __rmul__(self, factor: float) -> System:
        return System(*(factor * array for array in self.arrays().values()))


Misfit = Callable[[Placements], System]


@dataclass(frozen=True, eq=False)
class Freedom:
    """What may change, and how far it is from what is given.

    basis : [17, k], its columns are the combinations of unknowns that may change; or [P, 17, k], of
        each placement by itself, where columns of zeros change nothing.
    given : the placement that was given. deviation : [17], standard deviations of its error, or
        [P, 17] as ``basis``; infinite for unknowns that nothing is known about.
    """

    basis: Array
    given: Placements
    deviation: Array

    @classmethod
    def of(
        cls, given: Placements, *unknowns: slice | int, deviation: Array | None = None
    ) -> Freedom:
        """Each of the ``unknowns`` is free by itself; without ``deviation`` nothing is known."""
        unit = np.eye(UNKNOWNS)
        columns = [unit[:, [index] if isinstance(index, int) else index] for index in unknowns]
        deviation = np.full(UNKNOWNS, np.inf) if deviation is None else deviation
        return cls(np.concatenate(columns, 1), given, deviation)

    def __getitem__(self, rows: Rows) -> Freedom:
        """Of some of the placements."""
        basis = self.basis if self.basis.ndim == 2 else self.basis[rows]
        deviation = self.deviation if self.deviation.ndim == 1 else self.deviation[rows]
        return replace(self, basis=basis, deviation=deviation)

    def posterior(self, misfit: Misfit) -> Misfit:
        """Minus twice the logarithm of the posterior density, if ``misfit`` is a mean of squares.

        How large the residuals of the right placement are is not known: a wrong shape leaves large
        ones. For an unknown variance their likelihood falls with the logarithm of the misfit. So a
        cloud that can fit is drawn to its masks, and one that cannot stays near where it was given.
        """
        precision = 1.0 / np.square(self.deviation)
        curvature = precision[..., None] * np.eye(UNKNOWNS)

        def system(placements: Placements) -> System:
            at = misfit(placements)
            value = at.value + LEAST_MISFIT
            steep = INDEPENDENT / value
            change = np.zeros((len(placements), UNKNOWNS))
            if precision.any():
                change = placements.since(self.given)
            return System(
                INDEPENDENT * np.log(value) + (np.square(change) * precision).sum(1),
                steep[:, None, None] * at.normal + curvature,
                steep[:, None] * at.gradient - precision * change,
            )

        return system


def improve(
    placements: Placements, misfit: Misfit, freedom: Freedom, steps: int
) -> tuple[Placements, Array]:
    """The placements after at most ``steps`` steps, and `Freedom.posterior` of each [P].

    No placement gets worse.
    """
    damping = np.full(len(placements), FIRST_DAMPING)
    now = freedom.posterior(misfit)(placements)
    active = np.arange(len(placements))
    for _ in range(steps):
        at, system, free = placements[active], now[active], freedom[active]
        tried = at.stepped(_step(at, system, damping[active], free.basis))
        after = free.posterior(misfit)(tried)
        gain = system.value - after.value
        better = gain > 0.0
        placements = placements.replaced(active[better], tried[better])
        now = now.replaced(active[better], after[better])
        factor = np.where(better, FALL, RISE)
        damping[active] = np.maximum(factor * damping[active], LEAST_DAMPING)
        active = active[np.where(better, gain > ENOUGH, damping[active] < MOST_DAMPING)]
        if not len(active):
            break
    return placements, now.value


def _step(placements: Placements, system: System, damping: Array, basis: Array) -> Array:
    """A damped Gauss-Newton step [P, 17], as long as the linear model holds."""
    transposed = np.swapaxes(basis, -1, -2)
    normal = transposed @ system.normal @ basis
    diagonal = np.einsum("pii->pi", normal)
    least = ABSOLUTE_DAMPING * diagonal.max(1, keepdims=True) + np.finfo(float).tiny
    diagonal += damping[:, None] * diagonal + least
    step = (basis @ np.linalg.solve(normal, transposed @ system.gradient[..., None]))[..., 0]
    angle = np.linalg.norm(step[:, TURN], axis=1)
    moved = np.linalg.norm(step[:, SHIFT], axis=1) / placements.size
    scaled = np.abs(step[:, SCALES]).max(1)
    largest = np.maximum(np.maximum(angle, moved), scaled)
    shortened: Array = step / np.maximum(largest / LARGEST_STEP, 1.0)[:, None]
    return shortened
