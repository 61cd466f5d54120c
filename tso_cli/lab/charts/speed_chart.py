"""The chart of `tso bench speed`: small multiples, log-log where something grows."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

from ...io.output import atomic_output, check_output
from .speed_table import machine_line

INK, GREY, OWN = "#333333", "#999999", "#0072b2"
# Safe for colour-blind readers; the program's own comes first.
COLOURS = (OWN, "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#8c6d31", "#7f7f7f", "#9467bd")
MARKERS = "osD^vP*Xh"
Records = Sequence[dict[str, Any]]
Panel = Callable[[Any, Records], None]


def draw_speed(path: Path, record: dict[str, Any], overwrite: bool = False) -> None:
    """Times against the number of points with the limit drawn in, throughput, and the parts of steps and of start-up.

    Raises InputError if ``path`` cannot be written to.
    """
    check_output(path, overwrite)
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    panels = [
        (panel, chosen)
        for whats, panel in PANELS
        if (chosen := [r for r in record["records"] if r["what"] in whats and (r["seconds"] or "per_second" in r)])
    ]
    columns = min(3, len(panels)) or 1
    rows = -(-len(panels) // columns) or 1
    figure = Figure(figsize=(max(7.0, 5.2 * columns), 0.4 + 5.0 * rows), layout=ConstrainedLayoutEngine(w_pad=0.12, h_pad=0.12))
    FigureCanvasAgg(figure)
    axes = figure.subplots(rows, columns, squeeze=False).flatten()
    for axis, (panel, chosen) in zip(axes, panels, strict=False):
        panel(axis, chosen)
        axis.spines[["top", "right"]].set_visible(False)
    for axis in axes[len(panels) :]:
        axis.set_axis_off()
    where, _, _ = machine_line(record).partition(";")
    figure.suptitle(where, fontsize=11, color=INK)
    with atomic_output(path) as temporary:
        figure.savefig(temporary, dpi=110)


def _rates(axis: Any, records: Records) -> None:
    _bars(axis, [(r["name"], r["per_second"] / 1e9, "") for r in records], "10^9 a second")
    axis.set_title("what the machine does, float32")


def _silhouette(axis: Any, records: Records) -> None:
    measured = [r for r in records if r["what"] == "silhouette"]
    _lines(axis, measured)
    limits: dict[int, float] = {}
    for r in records:
        if r["what"] == "limit":
            limits[r["points"]] = max(limits.get(r["points"], 0.0), 1e3 * r["seconds"]["median"])
    if limits:
        axis.plot(list(limits), list(limits.values()), color=INK, linestyle="--", linewidth=1.2, label="limit of this machine")
        bottom = 0.5 * min(limits.values())
        axis.fill_between(list(limits), list(limits.values()), bottom, color=GREY, alpha=0.18, linewidth=0)
        axis.set_ylim(bottom=bottom)
    sizes = dict.fromkeys((r["points"], r["side"]) for r in measured)
    axis.set_xticks([n for n, _ in sizes], [f"{_short(n)}\n{side}²" for n, side in sizes])
    _finish(axis, "silhouette and cross-entropy, forward and backward", "points, below them pixels", "ms")


def _chamfer(axis: Any, records: Records) -> None:
    _lines(axis, [r for r in records if r["name"] != "tso, built once"])
    sizes = dict.fromkeys(r["points"] for r in records)
    axis.set_xticks(list(sizes), [_short(n) for n in sizes])
    _finish(axis, "Chamfer to the start, value and gradient", "points", "ms a step")


def _batch(axis: Any, records: Records) -> None:
    for preset, colour in (("best", OWN), ("paper", "#d55e00")):
        own = [r for r in records if r["preset"] == preset]
        together = [r for r in own if r["name"] == "refine_batch"]
        sizes = [r["batch"] for r in together]
        rates = [r["clouds_per_second"] for r in together]
        axis.plot(sizes, rates, color=colour, marker="o", linewidth=2, label=f"refine_batch, {preset}")
        alone = next(r["clouds_per_second"] for r in own if r["name"] == "refine")
        axis.axhline(alone, color=colour, linestyle="--", linewidth=1.2, label=f"refine, call by call, {preset}")
    axis.set_xscale("log")
    axis.set_yscale("log")
    axis.set_xticks(sizes, [str(size) for size in sizes])
    axis.minorticks_off()
    _finish(axis, f"clouds of {records[0]['points']:,} points", "clouds in one call", "clouds a second")


def _growth(axis: Any, records: Records) -> None:
    for colour, marker, by in (("#0072b2", "o", "points"), ("#d55e00", "s", "pixels")):
        own = [r for r in records if r["what"] == f"growth, {by}"]
        if own:
            sizes = [r["points"] if by == "points" else r["side"] ** 2 for r in own]
            fixed = f"{own[0]['side']}² pixels" if by == "points" else f"{own[0]['points']:,} points"
            label = f"more {by}, {fixed}: slope {own[0]['slope']:.2f}"
            times = [r["seconds"]["median"] / own[0]["seconds"]["median"] for r in own]
            axis.plot([size / sizes[0] for size in sizes], times, color=colour, marker=marker, linewidth=2, label=label)
    ends = axis.get_xlim()[1]
    axis.plot([1.0, ends], [1.0, ends], color=INK, linestyle="--", linewidth=1.2, label="slope 1")
    axis.set_xscale("log")
    axis.set_yscale("log")
    axis.set_xticks([1.0, 4.0, 16.0, 64.0], ["1", "4", "16", "64"])
    _finish(axis, "growth of the cost", "times as many", "times as long")


def _terms(axis: Any, records: Records) -> None:
    bars = [
        (f"{r['name']}\n{_short(r['points'])} points", r["over_projector"], f"{1e3 * r['seconds']['median']:.2g} ms")
        for r in records
        if r["name"] != "projector"
    ]
    _bars(axis, bars, "times the projector")
    axis.axvline(1.0, color=INK, linestyle="--", linewidth=1.2, zorder=0)
    axis.set_title("terms beside the projector")


def _steps(axis: Any, records: Records) -> None:
    labels: list[str] = []
    for size in dict.fromkeys(r["points"] for r in records if r["what"] == "step"):
        own = {r["name"]: r["seconds"]["median"] for r in records if r["what"] == "step" and r["points"] == size}
        whole = own.pop("whole step")
        _stack(axis, len(labels), {name: value / whole for name, value in own.items()}, COLOURS)
        labels.append(f"points, {size:,}\n{1e3 * whole:.3g} ms")
    for what in dict.fromkeys(r["what"] for r in records if r["what"] != "step"):
        own = {r["name"]: r["seconds"]["median"] for r in records if r["what"] == what}
        whole = own["whole step"]
        bare = min(own["bare network"] / whole, 1.0)
        _stack(axis, len(labels), {"bare network and Adam": bare, "projector and losses": 1.0 - bare}, ("#bbbbbb", "#e69f00"))
        labels.append(f"{what.partition(', ')[2]}\n{1e3 * whole:.3g} ms")
    axis.set_yticks(range(len(labels)), labels)
    axis.invert_yaxis()
    axis.set_xlim(0.0, 1.02)
    axis.set_xticks([0.0, 0.25, 0.5, 0.75, 1.0], ["0", "25", "50", "75", "100 %"])
    handles = dict(zip(*reversed(axis.get_legend_handles_labels()), strict=True))
    _legend(axis, handles.values(), handles.keys())
    axis.set_title("a step: measured parts over the whole")


def _threads(axis: Any, records: Records) -> None:
    most = max(r["threads"] for r in records)
    bars = [(f"{r['name']}\n{_short(r['points'])} points", r["over_first"], "") for r in records if r["threads"] == most]
    _bars(axis, bars, f"times quicker on {most} threads")
    axis.axvline(most, color=INK, linestyle="--", linewidth=1.2, zorder=0)
    axis.set_title("all cores beside one")


def _training(axis: Any, records: Records) -> None:
    bars = [(f"{r['what'].partition(', ')[2]}, {r['precision']}\n{r['name']}", r["images_per_second"], "") for r in records]
    _bars(axis, bars, "images a second")
    axis.set_title("training")


def _start_up(axis: Any, records: Records) -> None:
    _bars(axis, [(r["name"], r["seconds"]["median"], "") for r in records], "seconds")
    axis.set_title("whole processes")


PANELS: tuple[tuple[tuple[str, ...], Panel], ...] = (
    (("silhouette", "limit"), _silhouette),
    (("growth, points", "growth, pixels"), _growth),
    (("chamfer",), _chamfer),
    (("batch",), _batch),
    (("step", "step, encoder", "step, encoder-decoder"), _steps),
    (("terms",), _terms),
    (("threads",), _threads),
    (("training, points", "training, masks"), _training),
    (("start-up",), _start_up),
    (("rate",), _rates),
)


def _lines(axis: Any, records: Records) -> None:
    """Median and quartiles of each contestant over the number of points."""
    for i, name in enumerate(dict.fromkeys(r["name"] for r in records)):
        own = [r for r in records if r["name"] == name]
        colour, sizes = COLOURS[i % len(COLOURS)], [r["points"] for r in own]
        low, median, high = ([1e3 * r["seconds"][key] for r in own] for key in ("low", "median", "high"))
        style = {"color": colour, "marker": MARKERS[i % len(MARKERS)], "markersize": 5, "zorder": 3 if i == 0 else 2}
        axis.plot(sizes, median, label=name, linewidth=2.5 if i == 0 else 1.4, **style)
        axis.fill_between(sizes, low, high, color=colour, alpha=0.15, linewidth=0)
    axis.set_xscale("log")
    axis.set_yscale("log")


def _bars(axis: Any, bars: Sequence[tuple[str, float, str]], label: str) -> None:
    """(name, value, note): bars from the top down, the value behind each."""
    values = [value for _, value, _ in bars]
    axis.barh(range(len(bars)), values, color=OWN, height=0.6)
    for i, (_, value, note) in enumerate(bars):
        text = f"{value:.3g}" + (f" ({note})" if note else "")
        behind = {"facecolor": "white", "edgecolor": "none", "pad": 0.5}
        axis.annotate(text, (value, i), xytext=(4, 0), textcoords="offset points", va="center", fontsize=8, bbox=behind)
    axis.set_yticks(range(len(bars)), [name for name, _, _ in bars], fontsize=8)
    axis.set_xlim(0.0, 1.3 * max(values))
    axis.invert_yaxis()
    axis.set_xlabel(label)


def _stack(axis: Any, row: int, parts: dict[str, float], colours: Sequence[str]) -> None:
    left = 0.0
    for (name, share), colour in zip(parts.items(), colours, strict=False):
        axis.barh(row, share, left=left, color=colour, height=0.6, label=name)
        if share > 0.08:
            axis.text(left + share / 2.0, row, f"{100.0 * share:.0f}", ha="center", va="center", fontsize=8, color="white")
        left += share


def _finish(axis: Any, title: str, x: str, y: str) -> None:
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter, NullLocator

    axis.xaxis.set_minor_locator(NullLocator())
    low, high = axis.get_ylim()
    axis.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if high < 200.0 * low else (1.0,)))
    axis.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.yaxis.set_minor_formatter(NullFormatter())
    axis.set_title(title)
    axis.set_xlabel(x)
    axis.set_ylabel(y)
    _legend(axis, *axis.get_legend_handles_labels())


def _legend(axis: Any, handles: Iterable[Any], labels: Iterable[str]) -> None:
    axis.legend(
        list(handles), list(labels), loc="upper center", bbox_to_anchor=(0.5, -0.17), ncols=2, frameon=False, fontsize=8
    )


def _short(count: int) -> str:
    """1024 -> 1,024; 65536 -> 65.5k; 1000000 -> 1M."""
    if count >= 1_000_000:
        return f"{count / 1e6:.3g}M"
    return f"{count:,}" if count < 10_000 else f"{count / 1e3:.3g}k"
