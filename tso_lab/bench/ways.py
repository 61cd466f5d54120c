"""What `tso lab pareto` compares: settings of `refine`, and other ways to refine a cloud."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import cast

from tso_cli.geometry.points import Array
from tso_cli.geometry.view import View
from tso_cli.io.shipped import NO_PRIOR
from tso_cli.network.model import BaseNetwork
from tso_cli.optimisation.presets import Mode, Preset
from tso_cli.refinement import RefineConfig

from ..studies.cases import Case
from ..studies.refining import COMBINED, Variant, alone
from .peers import PEERS

CLOUD, PREDICTION = "other", "network"
STARTS = {CLOUD: "start: another shape of the type", PREDICTION: "start: the network's prediction"}
"""Kind of the cases -> its name."""
DEFAULT, PAPER = "points, best", "points, paper"
# Steps of each mode and preset; None: the preset's own.
STEPS: dict[str, tuple[int | None, ...]] = {
    DEFAULT: (5, 10, None, 40, 80),
    PAPER: (12, 25, None, 100, 200),
    **{f"{mode}, paper": (12, None) for mode in ("encoder", "encoder-decoder")},
    **{f"{mode}, best": (None,) for mode in ("encoder", "encoder-decoder")},
    "latent, paper": (12, None, 100),
    "latent, best": (15, None, 60),
}
PUBLISHED_SECONDS, PUBLISHED = 1.0, (0.94, 0.97)
"""The paper's own: 3 to 6 % nearer, in about a second."""


@dataclass(frozen=True)
class Way:
    """A point of the chart.

    line : ways of one line are joined. kinds : of the cases that it refines.
    points, size : of the cloud and of the mask.
    """

    run: Variant | Callable[[Array, Sequence[View]], Array]
    line: str = ""
    kinds: tuple[str, ...] = (CLOUD, PREDICTION)
    points: int = 1024
    size: int = 64

    @property
    def masks(self) -> int:
        return self.run.masks if isinstance(self.run, Variant) else 1

    def refined(self, case: Case, network: BaseNetwork | None) -> Array:
        if isinstance(self.run, Variant):
            return alone(case, self.run, network).points
        return self.run(case.initial, case.views[:1])


def _choices(line: str) -> tuple[Mode, Preset]:
    mode, preset = line.split(", ")
    return cast(Mode, mode), cast(Preset, preset)


def _by_steps(line: str) -> Iterator[tuple[str, Way]]:
    mode, preset = _choices(line)
    for steps in STEPS[line]:
        kinds = (PREDICTION,) if mode != "points" else (CLOUD,) if steps else (CLOUD, PREDICTION)
        name = f"{line}, {steps} steps" if steps else line
        run = Variant(RefineConfig(mode=mode, preset=preset, steps=steps))
        yield name, Way(run, line, kinds)


def _default(
    line: str = "", kinds: tuple[str, ...] = (CLOUD,), masks: int = 1, **changes: int
) -> Way:
    return Way(Variant(masks=masks), line, kinds, **changes)


BOTH = (CLOUD, PREDICTION)
WAYS: dict[str, Way] = {
    **dict(way for line in STEPS for way in _by_steps(line)),
    **{f"{DEFAULT}, {count} masks": _default("masks", BOTH, masks=count) for count in (2, 4)},
    **{f"{DEFAULT}, {n:,} points": _default("points", points=n) for n in (256, 4096, 16384)},
    **{f"{DEFAULT}, {size} px": _default("pixels", size=size) for size in (32, 128, 256)},
    # What the default decides, one decision changed at a time.
    f"{DEFAULT}, 512 move": Way(Variant(RefineConfig(points=512)), "moving", (CLOUD,)),
    f"{DEFAULT}, 4,096 points, all move": Way(
        Variant(RefineConfig(points=4096)), "", (CLOUD,), points=4096
    ),
    f"{DEFAULT}, no mirror plane": Way(Variant(RefineConfig(symmetry="none"))),
    f"{DEFAULT}, move shape": Way(Variant(RefineConfig(move="shape")), "", (CLOUD,)),
    f"{DEFAULT}, no learned prior": Way(Variant(RefineConfig(prior=NO_PRIOR))),
    **{name: Way(variant, kinds=(PREDICTION,)) for name, variant in COMBINED.items()},
    **{name: Way(peer) for name, peer in PEERS.items()},
}
"""What is compared; one line more is one point more on the chart."""
