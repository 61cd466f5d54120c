"""How wide should the Gaussian be? The true cloud's silhouette against the mask, over sigma^2."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from itertools import cycle, product
from pathlib import Path
from typing import Any

import numpy as np

from ...io.shipped import CATEGORIES
from ...losses.silhouette import silhouette_of
from ...plots.style import COLOURS, page
from ...render import RenderSettings
from ..study import (
    CATEGORY,
    COMMON,
    Cases,
    Option,
    Plan,
    Progress,
    Record,
    Study,
    Table,
    claim,
    part,
)
from .shapes import RenderedShape, Shape, see, shapes_of_part
from .summary import grouped

# From 0.05 to 3.2 px^2 in steps of the square root of two.
SIGMAS = tuple(round(0.05 * 2.0 ** (k / 2), 3) for k in range(13))
# The paper's choices.
PAPER = {"chair": 0.4, "car": 0.4, "airplane": 0.1, "all": 0.4}
SIZE = 64
CONVENTION = {
    "sigma_sq": f"px^2 of the {SIZE}x{SIZE} mask",
    "l1": "|silhouette - mask|, mean over pixels, views and shapes; the sum of missing and stray",
    "missing": "what the silhouette lacks of the mask; stray: what it has beyond it",
}


def plan(
    progress: Progress,
    *,
    meshes: Path,
    split: Path | None,
    categories: tuple[str, ...],
    limit: int | None,
    **settings: Any,
) -> Plan:
    """Project the true cloud of 1,024 points of each shape and compare its silhouette with the mask at 64x64."""
    shapes = shapes_of_part(
        meshes, split, settings["part"], categories or (() if split else CATEGORIES), limit
    )
    render = RenderSettings(views=settings["views"], size=(SIZE, SIZE))

    def judge(shape: Shape) -> Cases:
        seen = see(shape, render, settings["seed"])
        return [{"category": shape.category, "shape": shape.name, **mask_errors(seen)}]

    settings |= {"shapes": [shape.name for shape in shapes], "points": render.points}
    settings |= {"mask": f"{SIZE}x{SIZE}", "sigma_sq": list(SIGMAS)}
    return Plan(
        settings, [({"shape": shape.name}, partial(judge, shape)) for shape in shapes], "projecting"
    )


def mask_errors(seen: RenderedShape, sigmas: Sequence[float] = SIGMAS) -> dict[str, list[float]]:
    """Mean over pixels and views of what the true silhouette lacks, has too much, and both, for each sigma^2."""
    errors = np.zeros((2, len(sigmas)))
    for view, (k, sigma_sq) in product(seen.views, enumerate(sigmas)):
        over = (
            silhouette_of(seen.target, view.camera, sigma_sq) - view.mask.astype(np.float64) / 255.0
        )
        errors[:, k] += np.maximum(-over, 0.0).mean(), np.maximum(over, 0.0).mean()
    errors /= len(seen.views)
    return {
        "missing": errors[0].tolist(),
        "stray": errors[1].tolist(),
        "l1": errors.sum(0).tolist(),
    }


def _means(category: str, rows: Cases) -> Record:
    """Means over shapes; the best sigma^2, and the error at the paper's."""
    means = {key: np.mean([row[key] for row in rows], axis=0) for key in ("l1", "missing", "stray")}
    best, paper = int(means["l1"].argmin()), PAPER.get(category)
    at_paper = (
        None if paper is None else float(np.interp(np.log(paper), np.log(SIGMAS), means["l1"]))
    )
    figures = {
        "best": SIGMAS[best],
        "l1_at_best": float(means["l1"][best]),
        "paper": paper,
        "l1_at_paper": at_paper,
    }
    return {"shapes": len(rows), **{key: value.tolist() for key, value in means.items()}, **figures}


def conclude(cases: Cases) -> Record:
    """Means by category and of all, and what the paper says of sigma^2."""
    summary = {
        name: _means(name, group)
        for name, group in {**grouped(cases, "category"), "all": cases}.items()
    }
    return {"summary": summary, "claims": claims(summary)}


def claims(summary: Record) -> list[Record]:
    """What the paper says of sigma^2, whether it holds here, and the figures that say so."""
    overall = summary["all"]
    named = {
        name: row for name, row in summary.items() if row["paper"] is not None and name != "all"
    }
    best = ", ".join(
        f"{name} {row['best']:g} (the paper's {row['paper']:g})" for name, row in named.items()
    )
    missing, stray = overall["missing"], overall["stray"]
    measured = (
        f"missing {missing[0]:.4f} to {missing[-1]:.4f}, stray {stray[0]:.4f} to {stray[-1]:.4f}"
    )
    holes = bool(np.all(np.diff(missing) < 0.0) and np.all(np.diff(stray) > 0.0))
    near = all(0.5 <= row["best"] / row["paper"] <= 2.0 for row in named.values())
    answers = [
        claim(
            "a small sigma^2 leaves holes, a large one fills what is empty",
            holes,
            f"from {SIGMAS[0]:g} to {SIGMAS[-1]:g} px^2 {measured}",
        ),
        claim(
            "the paper's sigma^2 is within a factor of two of the best in every category",
            near,
            best,
        ),
    ]
    if "airplane" in named and len(named) > 1:
        smallest = min(row["best"] for name, row in named.items() if name != "airplane")
        nearest = min(SIGMAS, key=lambda sigma_sq: abs(np.log(sigma_sq / overall["paper"])))
        text, over = (
            f"{overall['paper']:g} is best for all categories together",
            f"over all {overall['shapes']} shapes",
        )
        answers += [
            claim(
                "aeroplanes want a smaller sigma^2 than chairs and cars",
                named["airplane"]["best"] < smallest,
                best,
            ),
            claim(text, overall["best"] == nearest, f"{overall['best']:g} {over}"),
        ]
    return answers


def tables(record: Record) -> list[Table]:
    """The error at every sigma^2, and each category's best beside the paper's choice."""
    summary, sigmas = record["summary"], record["settings"]["sigma_sq"]
    errors = [
        [f"{sigma_sq:g}", *(row["l1"][k] for row in summary.values())]
        for k, sigma_sq in enumerate(sigmas)
    ]
    best = [
        [
            name,
            row["shapes"],
            f"{row['best']:g}",
            row["l1_at_best"],
            row["paper"] and f"{row['paper']:g}",
            row["l1_at_paper"],
        ]
        for name, row in summary.items()
    ]
    header = ["category", "shapes", "best sigma^2", "error", "the paper's", "error there"]
    return [Table(["sigma^2", *summary], errors, decimals=4), Table(header, best, decimals=4)]


def draw(path: Path, record: Record, overwrite: bool = False) -> None:
    """L1 error over sigma^2 by category, its best and the paper's choice."""
    with page(path, overwrite, (7.5, 4.2)) as figure:
        axis = figure.subplots()
        sigmas = record["settings"]["sigma_sq"]
        categories = [(name, row) for name, row in record["summary"].items() if name != "all"]
        for colour, (name, row) in zip(cycle(COLOURS), categories, strict=False):
            axis.plot(
                sigmas,
                row["l1"],
                color=colour,
                linewidth=2,
                label=f"{name}, {row['shapes']} shapes",
            )
            for key, dashes in (("missing", "--"), ("stray", ":")):
                axis.plot(sigmas, row[key], color=colour, linewidth=0.9, linestyle=dashes)
            axis.plot(row["best"], row["l1_at_best"], "o", color=colour, markersize=7)
            if row["paper"] is not None:
                axis.plot(
                    row["paper"],
                    row["l1_at_paper"],
                    "D",
                    color="white",
                    markeredgecolor=colour,
                    markersize=8,
                )
        axis.set(xscale="log", xlabel="sigma^2 (px^2 at 64x64)", ylabel="mean |silhouette - mask|")
        axis.set_xticks(sigmas[::2], [f"{sigma_sq:g}" for sigma_sq in sigmas[::2]])
        axis.set_xticks([], minor=True)
        axis.set_ylim(bottom=0.0)
        axis.set_title(
            "dot: best, diamond: the paper's; dashed: what is missing, dotted: what is stray",
            fontsize=10,
        )
        axis.legend(frameon=False, loc="upper center")


STUDY = Study(
    name="sigma",
    about="Each shape's true cloud of 1,024 points is projected at 64x64 with growing sigma^2 and compared with the mask.",
    parts=("pictures", "points, paper"),
    tables=tables,
    draw=draw,
    reading="A narrow Gaussian leaves holes between the points, a wide one blurs the outline and fills gaps. The best width "
    "depends on how densely the points cover the mask, so thin shapes want a smaller one; between the extremes the error is "
    "flat.",
    convention=CONVENTION,
    options=(
        *COMMON,
        part("test", "test", "validation", "train"),
        CATEGORY,
        Option("--views", "Random views of each shape.", int, 4, least=1),
    ),
    plan=plan,
    conclude=conclude,
)
