"""How wide should the Gaussian be? The true cloud's silhouette against the mask, over sigma^2."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import cycle, product
from pathlib import Path
from typing import Any

import numpy as np

from tso_cli.io.shipped import CATEGORIES
from tso_cli.losses.silhouette import silhouette_of
from tso_cli.plots.style import COLOURS, page
from tso_cli.render.settings import RenderSettings

from .. import options
from ..study import Cases, Plan, Progress, Record, Study, Table, by_shape, claim
from .shapes import RenderedShape, Shape, see, shapes_of_part
from .summary import grouped

# From 0.05 to 3.2 px^2 in steps of the square root of two.
SIGMAS = tuple(round(0.05 * 2.0 ** (k / 2), 3) for k in range(13))
PAPER = {"chair": 0.4, "car": 0.4, "airplane": 0.1, "all": 0.4}
SIZE = 64
# Keys of the records: the silhouette's lack within the mask, its excess outside, and their sum.
MISSING, EXCESS, ERROR = "missing", "stray", "l1"


def plan(
    progress: Progress,
    *,
    meshes: Path,
    split: Path | None,
    categories: tuple[str, ...],
    limit: int | None,
    **settings: Any,
) -> Plan:
    """Project the true cloud of 1,024 points of each shape and compare it with the 64x64 mask."""
    names = categories or (() if split else CATEGORIES)
    shapes = shapes_of_part(meshes, split, settings["part"], names, limit)
    render = RenderSettings(views=settings["views"], size=(SIZE, SIZE))

    def compare(shape: Shape) -> Cases:
        errors = mask_errors(see(shape, render, settings["seed"]))
        return [{"category": shape.category, "shape": shape.name, **errors}]

    more = {"points": render.points, "mask": f"{SIZE}x{SIZE}", "sigma_sq": list(SIGMAS)}
    return by_shape({**settings, "shapes": [], **more}, shapes, compare, "projecting")


def mask_errors(seen: RenderedShape, sigmas: Sequence[float] = SIGMAS) -> dict[str, list[float]]:
    """Mean over pixels and views of what is missing, in excess, and both, for each sigma^2."""
    errors = np.zeros((2, len(sigmas)))
    for view, (k, sigma_sq) in product(seen.views, enumerate(sigmas)):
        silhouette = silhouette_of(seen.target, view.camera, sigma_sq)
        over = silhouette - view.mask.astype(np.float64) / 255.0
        errors[:, k] += np.maximum(-over, 0.0).mean(), np.maximum(over, 0.0).mean()
    errors /= len(seen.views)
    both = {MISSING: errors[0].tolist(), EXCESS: errors[1].tolist()}
    return {**both, ERROR: errors.sum(0).tolist()}


def conclude(cases: Cases) -> Record:
    """Means by category and of all, and what the paper says of sigma^2."""
    groups = {**grouped(cases, "category"), "all": cases}
    summary = {name: _means(name, group) for name, group in groups.items()}
    return {"summary": summary, "claims": claims(summary)}


def _means(category: str, rows: Cases) -> Record:
    """Means over shapes; the best sigma^2, and the error at the paper's."""
    means = {key: np.mean([row[key] for row in rows], axis=0) for key in (ERROR, MISSING, EXCESS)}
    best, paper = int(means[ERROR].argmin()), PAPER.get(category)
    there = float(np.interp(np.log(paper), np.log(SIGMAS), means[ERROR])) if paper else None
    figures = {"best": SIGMAS[best], "l1_at_best": float(means[ERROR][best])}
    figures |= {"paper": paper, "l1_at_paper": there}
    return {"shapes": len(rows), **{k: mean.tolist() for k, mean in means.items()}, **figures}


def claims(summary: Record) -> list[Record]:
    """What the paper says of sigma^2, whether it holds here, and the figures."""
    overall = summary["all"]
    stated = {name: row for name, row in summary.items() if row["paper"] and name != "all"}
    best = ", ".join(
        f"{name} {row['best']:g} (the paper's {row['paper']:g})" for name, row in stated.items()
    )
    missing, excess = overall[MISSING], overall[EXCESS]
    holes = bool(np.all(np.diff(missing) < 0.0) and np.all(np.diff(excess) > 0.0))
    near = all(0.5 <= row["best"] / row["paper"] <= 2.0 for row in stated.values())
    measured = f"from {SIGMAS[0]:g} to {SIGMAS[-1]:g} px^2 missing {missing[0]:.4f} to "
    measured += f"{missing[-1]:.4f}, excess {excess[0]:.4f} to {excess[-1]:.4f}"
    factor = "the paper's sigma^2 is within a factor of two of the best in every category"
    answers = [
        claim("a small sigma^2 leaves holes, a large one fills what is empty", holes, measured),
        claim(factor, near, best),
    ]
    if "airplane" in stated and len(stated) > 1:
        smallest = min(row["best"] for name, row in stated.items() if name != "airplane")
        smaller = stated["airplane"]["best"] < smallest
        nearest = min(SIGMAS, key=lambda sigma_sq: abs(np.log(sigma_sq / overall["paper"])))
        text = f"{overall['paper']:g} is best for all categories together"
        over = f"{overall['best']:g} over all {overall['shapes']} shapes"
        answers += [
            claim("aeroplanes need a smaller sigma^2 than chairs and cars", smaller, best),
            claim(text, overall["best"] == nearest, over),
        ]
    return answers


def tables(record: Record) -> list[Table]:
    """The error at every sigma^2, and each category's best with the paper's choice."""
    summary, sigmas = record["summary"], record["settings"]["sigma_sq"]
    errors = [
        [f"{sigma_sq:g}", *(row[ERROR][k] for row in summary.values())]
        for k, sigma_sq in enumerate(sigmas)
    ]
    best = [
        [name, row["shapes"], f"{row['best']:g}", row["l1_at_best"]]
        + [row["paper"] and f"{row['paper']:g}", row["l1_at_paper"]]
        for name, row in summary.items()
    ]
    header = ["category", "shapes", "best sigma^2", "error", "the paper's", "error there"]
    return [Table(["sigma^2", *summary], errors, decimals=4), Table(header, best, decimals=4)]


def draw(path: Path, record: Record, overwrite: bool = False) -> None:
    """The error over sigma^2 by category, its best and the paper's choice."""
    with page(path, overwrite, (7.5, 4.2)) as figure:
        axis = figure.subplots()
        sigmas = record["settings"]["sigma_sq"]
        categories = [(name, row) for name, row in record["summary"].items() if name != "all"]
        for colour, (name, row) in zip(cycle(COLOURS), categories, strict=False):
            label = f"{name}, {row['shapes']} shapes"
            axis.plot(sigmas, row[ERROR], color=colour, linewidth=2, label=label)
            for key, dashes in ((MISSING, "--"), (EXCESS, ":")):
                axis.plot(sigmas, row[key], color=colour, linewidth=0.9, linestyle=dashes)
            axis.plot(row["best"], row["l1_at_best"], "o", color=colour, markersize=7)
            if row["paper"] is not None:
                place = row["paper"], row["l1_at_paper"]
                axis.plot(*place, "D", color="white", markeredgecolor=colour, markersize=8)
        axis.set(xscale="log", xlabel="sigma^2 (px^2 at 64x64)", ylabel="mean |silhouette - mask|")
        axis.set_xticks(sigmas[::2], [f"{sigma_sq:g}" for sigma_sq in sigmas[::2]])
        axis.set_xticks([], minor=True)
        axis.set_ylim(bottom=0.0)
        title = "dot: best, diamond: the paper's; dashed: missing, dotted: excess"
        axis.set_title(title, fontsize=10)
        axis.legend(frameon=False, loc="upper center")


STUDY = Study(
    name="sigma",
    parts=("pictures", "points, paper"),
    tables=tables,
    draw=draw,
    options=(
        *options.COMMON,
        options.part("test", "test", "validation", "train"),
        options.categories(),
        options.views(4),
    ),
    plan=plan,
    conclude=conclude,
)
