"""`tso lab pareto`: accuracy against seconds, swept over what a user can choose."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any, cast

import numpy as np
from threadpoolctl import threadpool_limits

from tso_cli.evaluation.metrics import chamfer
from tso_cli.geometry.points import Array
from tso_cli.geometry.view import View
from tso_cli.io.shipped import NO_PRIOR, default_checkpoint
from tso_cli.network.model import BaseNetwork
from tso_cli.optimisation.presets import Mode, Preset
from tso_cli.plots.style import COLOURS, INK, PALE, page
from tso_cli.refinement import RefineConfig

from .. import options
from ..studies.accuracy import CATEGORIES
from ..studies.cases import COMBINED, Case, CaseBuilder, Variant, alone, kinds_of
from ..studies.shapes import Shape, shapes_of_part, view_aligned_network, weights_hash
from ..studies.summary import grouped, ratio_figures, rounded, standard_error
from ..study import Cases, Plan, Progress, Record, Study, Table, claim
from .peers import PEERS
from .timing import machine, timed

BOTH = CLOUD, PREDICTION = "other", "network"
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
    kinds: tuple[str, ...] = BOTH
    points: int = 1024
    size: int = 64

    @property
    def masks(self) -> int:
        return self.run.masks if isinstance(self.run, Variant) else 1

    def refined(self, case: Case, network: BaseNetwork | None) -> Array:
        if isinstance(self.run, Variant):
            return alone(case, self.run, network).points
        return self.run(case.initial, case.views[:1])


def _by_steps(line: str) -> Iterator[tuple[str, Way]]:
    mode, preset = cast(tuple[Mode, Preset], line.split(", "))
    for steps in STEPS[line]:
        kinds = (PREDICTION,) if mode != "points" else (CLOUD,) if steps else BOTH
        run = Variant(RefineConfig(mode=mode, preset=preset, steps=steps))
        yield f"{line}, {steps} steps" if steps else line, Way(run, line, kinds)


WAYS: dict[str, Way] = {
    **dict(way for line in STEPS for way in _by_steps(line)),
    **{f"{DEFAULT}, {n} masks": Way(Variant(masks=n), "masks") for n in (2, 4)},
    **{
        f"{DEFAULT}, {n:,} points": Way(Variant(), "points", (CLOUD,), points=n)
        for n in (256, 4096, 16384)
    },
    **{f"{DEFAULT}, {n} px": Way(Variant(), "pixels", (CLOUD,), size=n) for n in (32, 128, 256)},
    # What the default decides, one decision changed at a time.
    f"{DEFAULT}, 512 move": Way(Variant(RefineConfig(points=512)), "moving", (CLOUD,)),
    f"{DEFAULT}, 4,096 points, all move": Way(
        Variant(RefineConfig(points=4096)), kinds=(CLOUD,), points=4096
    ),
    f"{DEFAULT}, no mirror plane": Way(Variant(RefineConfig(symmetry="none"))),
    f"{DEFAULT}, move shape": Way(Variant(RefineConfig(move="shape")), kinds=(CLOUD,)),
    f"{DEFAULT}, no learned prior": Way(Variant(RefineConfig(prior=NO_PRIOR))),
    **{name: Way(variant, kinds=(PREDICTION,)) for name, variant in COMBINED.items()},
    **{name: Way(peer) for name, peer in PEERS.items()},
}
"""What is compared; one line more is one point more on the chart."""


def plan(
    progress: Progress,
    *,
    meshes: Path,
    split: Path | None,
    limit: int | None,
    seed: int,
    categories: Sequence[str] = CATEGORIES,
    ways: Mapping[str, Way] = WAYS,
) -> Plan:
    """Refine every case in every way, one call after the other.

    A job is one shape, so that a busy time slows all ways alike.
    """
    shapes = shapes_of_part(meshes, split, "test", categories, limit)
    network, about = view_aligned_network(default_checkpoint())
    builder = CaseBuilder(meshes, split, 1, 64, 1024, seed, network, about)
    settings: Record = {"limit": limit, "seed": seed, "machine": machine()}
    settings |= {"shapes": [shape.name for shape in shapes], "ways": list(ways)}
    settings |= {"network": weights_hash(network)}
    warm = set[str]()

    @threadpool_limits.wrap(limits=1)
    def measure(shape: Shape) -> Cases:
        cases = []
        for kind in kinds_of(shape.category, tuple(STARTS)):
            of_kind = {name: way for name, way in ways.items() if kind in way.kinds}
            scales = {(way.points, way.size) for way in of_kind.values()}
            built = {
                (points, size): replace(builder, points=points, size=size).cases(shape, kind)[0]
                for points, size in scales
            }
            rows = {}
            for name, way in of_kind.items():
                for _ in range(1 if name in warm else 2):
                    rows[name] = _timed(built[way.points, way.size], way, network)
                warm.add(name)
            names = {"kind": kind, "category": shape.category, "shape": shape.name}
            cases.append({**names, "ways": rows})
        return cases

    return Plan(settings, [({"shape": shape.name}, partial(measure, shape)) for shape in shapes])


def _timed(case: Case, way: Way, network: BaseNetwork | None) -> Record:
    results: list[Array] = []
    seconds = timed(lambda: results.append(way.refined(case, network)))()
    before, after = (chamfer(points, case.target).chamfer for points in (case.initial, results[0]))
    return rounded({"ratio": after / before, "seconds": seconds})


def front(places: Sequence[tuple[float, float]]) -> list[int]:
    """The Pareto front of (seconds, ratio), in the order of the seconds; of equal ones all.

    No other place is less in one of the two and at most equal in the other.
    """
    best, last, chosen = float("inf"), (float("nan"), float("nan")), []
    for number in sorted(range(len(places)), key=lambda i: places[i]):
        if places[number][1] < best or places[number] == last:
            chosen.append(number)
            best, last = places[number][1], places[number]
    return chosen


def conclude(cases: Cases) -> Record:
    """{"summary": {kind: {"cases", "ways": {way: {...}}, "front": [...]}}, "claims"}."""
    summary = {kind: _summary(of_kind) for kind, of_kind in grouped(cases, "kind").items()}
    return {"summary": summary, "claims": [*_claims(summary)]}


def _summary(cases: Cases) -> Record:
    ways = {}
    for name in cases[0]["ways"]:
        rows = [case["ways"][name] for case in cases]
        ratios = np.array([row["ratio"] for row in rows])
        figures = {**ratio_figures(ratios), "standard_error": standard_error(ratios)}
        figures |= {"median_seconds": float(np.median([row["seconds"] for row in rows]))}
        ways[name] = rounded(figures)
    one_mask = [name for name in ways if WAYS[name].masks == 1]
    places = [(ways[name]["median_seconds"], ways[name]["mean_ratio"]) for name in one_mask]
    chosen = [one_mask[i] for i in front(places)]
    return {"cases": len(cases), "ways": ways, "front": chosen}


def _claims(summary: Record) -> Iterator[Record]:
    for kind, group in summary.items():
        ways, start = group["ways"], STARTS[kind]
        ours = ways[DEFAULT]
        ratio, seconds = ours["mean_ratio"], ours["median_seconds"]
        text = f"{ratio:.3f} in {seconds:.2f} s; the front: {'; '.join(group['front'])}"
        yield claim(f"{start}: the default is on the front", DEFAULT in group["front"], text)
        nearest = min((PAPER, *PEERS), key=lambda name: ways[name]["mean_ratio"])
        other = ways[nearest]
        text = (
            f"{ratio:.3f}; {nearest} {other['mean_ratio']:.3f} in {other['median_seconds']:.2f} s"
        )
        highest = ratio + ours["standard_error"]
        holds = highest < other["mean_ratio"] - other["standard_error"]
        what = "the default is nearer than the paper's preset and other ways, beyond the errors"
        yield claim(f"{start}: {what}", holds, text)
        if kind == PREDICTION:
            text = "predictions: nearer than the paper reports, and as quick"
            holds = ratio <= min(PUBLISHED) and seconds <= PUBLISHED_SECONDS
            yield claim(text, holds, f"{ratio:.3f} in {seconds:.2f} s")


COLUMNS = {
    "median_seconds": "s",
    "mean_ratio": "ratio",
    "standard_error": "standard error",
    "worst_ratio": "worst",
    "worse": "worse",
}


def tables(record: Record) -> list[Table]:
    """A table for each start, the quickest way first."""
    by_start = []
    for kind, group in record["summary"].items():
        ordered = sorted(group["ways"].items(), key=lambda item: item[1]["median_seconds"])
        rows = [
            [name, *map(row.get, COLUMNS), "yes" if name in group["front"] else ""]
            for name, row in ordered
        ]
        title = f"{STARTS[kind]}: {group['cases']} shapes"
        by_start.append(Table(["way", *COLUMNS.values(), "front"], rows, title))
    of = record["settings"]["machine"]
    place = f"{of['cpu']}, {of['cores']} cores"
    return [*by_start, Table(["measured on"], [[place]])]


# The chart.

MODES = {
    "points": COLOURS[0],
    "encoder": COLOURS[4],
    "encoder-decoder": COLOURS[2],
    "latent": COLOURS[3],
}
OTHERS = "#777777"
# Where a label may stand: points from its place, and on which side; the nearest spots first.
SPOTS = [
    (distance, side)
    for distance in (6, 14, 24, 36, 50)
    for side in product((1, -1, 0), (1, -1, 0))
    if any(side)
]
ACROSS, UP = {1: "left", 0: "center", -1: "right"}, {1: "bottom", 0: "center", -1: "top"}


def draw(path: Path, record: Record, overwrite: bool) -> None:
    """Ratio against seconds, a panel for each start."""
    from matplotlib.lines import Line2D
    from matplotlib.ticker import LogLocator, NullFormatter

    # Predictions gain little: with several masks on the axis, the modes would fall together.
    panels: Record = {}
    for kind, group in record["summary"].items():
        ways = {
            name: row
            for name, row in group["ways"].items()
            if kind == CLOUD or WAYS[name].masks == 1
        }
        panels[kind] = {"ways": ways, "front": [name for name in group["front"] if name in ways]}
    with page(path, overwrite, (9.0, 5.8), dpi=100) as figure:
        axes = figure.subplots(1, len(panels), squeeze=False)[0]
        for axis, (kind, group) in zip(axes, panels.items(), strict=True):
            _draw_ways(axis, group)
            if kind == PREDICTION:
                middle, half = sum(PUBLISHED) / 2, (PUBLISHED[1] - PUBLISHED[0]) / 2
                style = {"fmt": "D", "color": INK, "capsize": 4, "markersize": 5}
                axis.errorbar(PUBLISHED_SECONDS, middle, half, **style)
            axis.set(title=STARTS[kind], xscale="log")
            axis.margins(x=0.12)
            axis.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axis.xaxis.set_major_formatter("{x:g}")
            axis.xaxis.set_minor_formatter(NullFormatter())
        axes[0].set_ylabel("Chamfer distance after / before")
        text = "median seconds an object, one thread; bars: standard error over shapes"
        figure.supxlabel(text, fontsize=9)
        hollow = {"marker": "o", "markerfacecolor": "white", "ls": "--"}
        styles: dict[str, Any] = {
            **{f"{mode} mode": {"color": colour, "marker": "o"} for mode, colour in MODES.items()},
            "hollow: the paper's preset": {"color": INK, **hollow},
            "other ways, with the paper's steps": {"color": OTHERS, "marker": "X", "ls": ""},
            "as the paper reports": {"color": INK, "marker": "D", "ls": ""},
            "Pareto front, one mask": {"color": PALE, "linewidth": 6},
        }
        handles = [Line2D([], [], label=label, **style) for label, style in styles.items()]
        place: Any = {"loc": "outside upper center", "ncols": 4, "frameon": False, "fontsize": 8}
        figure.legend(handles=handles, **place)
        figure.draw_without_rendering()  # labels are placed in pixels: the axes must stand first
        for axis, (kind, group) in zip(axes, panels.items(), strict=True):
            _label(axis, group, with_peers=kind == CLOUD)


def _place(row: Record) -> tuple[float, float]:
    return row["median_seconds"], row["mean_ratio"]


def lines(group: Record) -> dict[str, list[str]]:
    """Line -> its ways, in the order of what is swept.

    Sweeps of anything but steps go through the default.
    """
    lines: dict[str, list[str]] = {}
    for name in group["ways"]:
        line = WAYS[name].line or name
        lines.setdefault(line, [] if line in group["ways"] else [DEFAULT]).append(name)

    def swept(name: str) -> tuple[int, int, int]:
        return WAYS[name].points, WAYS[name].size, WAYS[name].masks

    return {line: sorted(names, key=swept) for line, names in lines.items()}


def _draw_ways(axis: Any, group: Record) -> None:
    ways = group["ways"]
    front = zip(*(_place(ways[name]) for name in group["front"]), strict=True)
    axis.plot(*front, color=PALE, linewidth=7, alpha=0.6, zorder=1)
    axis.axhline(1.0, color=INK, linewidth=0.8, zorder=0)
    for line, names in lines(group).items():
        run = WAYS[names[0]].run
        colour, preset = OTHERS, ""
        if isinstance(run, Variant):
            colour, preset = MODES[run.config.mode], run.config.preset
        seconds, ratios = zip(*(_place(ways[name]) for name in names), strict=True)
        errors = [ways[name]["standard_error"] for name in names]
        dashes = "--" if preset == "paper" else "-" if line in ways else ":"
        face = "white" if preset == "paper" else colour
        style = {"linestyle": dashes, "linewidth": 1.3, "elinewidth": 0.5, "zorder": 3}
        style |= {"marker": "o" if preset else "X", "markersize": 5, "markerfacecolor": face}
        axis.errorbar(seconds, ratios, errors, color=colour, **style)
    star = {"color": MODES["points"], "markersize": 16, "markeredgecolor": "white", "zorder": 4}
    axis.plot(*_place(ways[DEFAULT]), "*", **star)


def _label(axis: Any, group: Record, with_peers: bool) -> None:
    """Name the presets, the front, the ends of sweeps and single ways; peers only if told."""
    from matplotlib.patheffects import withStroke
    from matplotlib.text import Text
    from matplotlib.transforms import Bbox

    ways, renderer = group["ways"], axis.figure.canvas.get_renderer()
    ends = [names[-1] for line, names in lines(group).items() if line not in STEPS]
    centres = [axis.transData.transform(_place(row)) for row in ways.values()]
    taken = [Bbox.from_bounds(x - 4, y - 4, 8, 8) for x, y in centres]
    style = {"fontsize": 8, "color": INK, "textcoords": "offset points", "zorder": 5}
    style |= {"path_effects": [withStroke(linewidth=2.5, foreground="white")]}
    arrow = {"arrowstyle": "-", "color": OTHERS, "linewidth": 0.5}
    for name in dict.fromkeys([DEFAULT, PAPER, *group["front"], *ends]):
        if name in PEERS and not with_peers:
            continue
        text = {DEFAULT: "default", PAPER: "paper"}.get(name) or name.removeprefix(f"{DEFAULT}, ")
        text = text.replace("points, paper, ", "").replace(", best", "")
        weight = "bold" if name == DEFAULT else "normal"
        for distance, (across, up) in SPOTS:
            note = axis.annotate(
                text,
                _place(ways[name]),
                (across * distance, up * distance),
                ha=ACROSS[across],
                va=UP[up],
                weight=weight,
                arrowprops=arrow if distance > SPOTS[0][0] else None,
                **style,
            )
            note.set_in_layout(False)
            note.update_positions(renderer)
            box = Text.get_window_extent(note, renderer)  # without the line to it
            frame = axis.bbox
            inside = frame.containsx(box.x0) and frame.containsx(box.x1)
            if inside and frame.containsy(box.y1) and not any(map(box.overlaps, taken)):
                taken.append(box)
                break
            note.remove()


STUDY = Study(
    name="pareto",
    parts=(
        "pictures",
        "points, paper",
        "points, best",
        "network modes, paper",
        "network modes, best",
    ),
    tables=tables,
    draw=draw,
    options=options.COMMON,
    plan=plan,
    conclude=conclude,
)
