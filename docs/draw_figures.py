"""Draw three figures of the pages: the steps of the method, conventions, and families of shapes.

python docs/draw_figures.py [FOLDER]   writes pipeline.png, conventions.png and families.png;
default: docs
"""

import sys
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import FancyBboxPatch, Rectangle
from scipy.spatial import cKDTree

from tso_cli import Camera, RefineConfig, View, refine
from tso_cli.cloud.cloud import Cloud
from tso_cli.geometry.resampling import area_resize
from tso_cli.geometry.window import window_of
from tso_cli.io.cameras import read_camera
from tso_cli.io.clouds import read_cloud
from tso_cli.io.masks import read_mask
from tso_cli.io.meshes import Mesh
from tso_cli.optimisation.learned_start import beginning
from tso_cli.optimisation.optimise import weigh
from tso_cli.optimisation.problem import prepare
from tso_cli.prior import named_prior
from tso_cli.render.families import FAMILIES, shape_of
from tso_cli.render.rays import RayScene
from tso_cli.render.viewpoints import look_at

DOCS = Path(__file__).parent
CHAIR = DOCS.parent / "examples" / "chair"
# Cells along the side of a window, and how near a point must be to cover a cell: as in the method.
CELLS, COVERED_WITHIN = 64, 0.7
# Colours that are told apart without colour vision too.
MASK, POINTS, WRONG, MISSING, INK = "#c9ced4", "#1f3b57", "#d95f02", "#0072b2", "#222222"
ROWS, COLUMNS, SIDE = 5, 8, 160
AXES = {"x": "#d62728", "y": "#2ca02c", "z": "#1f77b4"}


# ---------------------------------------------------------------------------------- pipeline


def draw_pipeline(path: Path) -> None:
    """The steps of the default preset, above what each makes of the shipped chair."""
    mask = read_mask(CHAIR / "mask.png")
    height, width = mask.shape
    camera = read_camera(CHAIR / "camera.json", width, height)
    initial = read_cloud(CHAIR / "initial.ply").points
    view = View(mask, camera)
    moved, refined = _moved_by_the_prior(initial, view), refine(initial, mask, camera).points
    box = window_of(view, initial)
    cells = area_resize(mask, box, CELLS, CELLS)[0]
    in_window = camera.cropped(box, CELLS, CELLS)

    titles = (
        "mask, cloud and window",
        "resampled: 64 x 64 cells",
        "flipped view: a second picture",
        "moved by the learned prior",
        "pairs that attract, for the start",
        "result",
    )
    figure = plt.figure(figsize=(13.0, 4.5), dpi=110)
    _draw_boxes(figure.add_axes((0.0, 0.53, 1.0, 0.47)))
    panels = [figure.add_axes((0.01 + 0.1655 * i, 0.01, 0.1525, 0.45)) for i in range(len(titles))]
    for panel, title in zip(panels, titles, strict=True):
        panel.set_title(title, fontsize=9.0)
        panel.set_xticks([])
        panel.set_yticks([])

    pixels = camera.project(initial)[0]
    _show_mask(panels[0], mask)
    _show_points(panels[0], pixels)
    left, top, right, bottom = box
    panels[0].add_patch(Rectangle((left, top), right - left, bottom - top, fill=False, ec=WRONG))
    panels[0].set_xlim(-8.5, width + 7.5)
    panels[0].set_ylim(height + 7.5, -8.5)

    _show_mask(panels[1], cells)
    _show_points(panels[1], in_window.project(initial)[0])

    # The mirror plane of this chair is x = 0. Its mirror image, seen by the camera and flipped.
    flipped = in_window.project(initial * [-1.0, 1.0, 1.0])[0]
    flipped[:, 0] = CELLS - 1.0 - flipped[:, 0]
    _show_mask(panels[2], cells[:, ::-1])
    _show_points(panels[2], flipped)

    _show_mask(panels[3], cells)
    _show_points(panels[3], in_window.project(moved)[0])

    _show_mask(panels[4], cells)
    _show_pairs(panels[4], cells > 0.5, in_window.project(moved)[0])

    _show_mask(panels[5], cells)
    _show_points(panels[5], in_window.project(refined)[0])
    figure.savefig(path)
    plt.close(figure)


def _moved_by_the_prior(initial: np.ndarray, view: View) -> np.ndarray:
    """Where the optimisation begins: the points [N, 3] as the shipped learned prior moves them."""
    settings = RefineConfig().settings()
    cloud = Cloud(initial, "initial").controlled(settings.points, (view,))
    weighed = weigh(prepare(cloud, (view,), settings), settings)
    prior = named_prior(settings.prior)
    begun = beginning(weighed.problem, weighed.weights, prior)
    return cloud.denormalise(begun.points)


def _draw_boxes(axes: Axes) -> None:
    axes.set_xlim(0.0, 13.0)
    axes.set_ylim(0.6, 2.7)
    axes.axis("off")
    steps = (
        ("explain", "why do cloud and masks\ndiffer? findings, place,\ncamera, mask, or shape"),
        ("prepare", "control points, windows,\nweights of the views"),
        ("mirror", "with a mirror plane, each\nmask is a second view\nof the object"),
        ("move", "the learned prior moves\nthe start to a likely shape\nthat the masks show"),
        ("optimise", "steps of the points make\npoints and masks agree"),
        ("judge", "confidence and verdict:\ntake the displacement\nor leave it"),
    )
    # Of a box, and from the left of a box to the left of the next.
    width, apart = 1.86, 2.15
    middles = [0.18 + width / 2.0 + apart * number for number in range(len(steps))]
    for number, (middle, (name, text)) in enumerate(zip(middles, steps, strict=True)):
        left = middle - width / 2.0
        box = FancyBboxPatch(
            (left, 0.75), width, 1.3, boxstyle="round,pad=0.05", fc="#eef2f6", ec=POINTS, lw=1.2
        )
        axes.add_patch(box)
        axes.text(middle, 1.82, name, ha="center", weight="bold", fontsize=12, color=INK)
        axes.text(middle, 1.2, text, ha="center", va="center", fontsize=9.0, color=INK)
        if number:
            _arrow(axes, (left - 0.26, 1.4), (left - 0.03, 1.4))
    ends = ((middles[0], "cloud, masks, cameras"), (middles[-1], "cloud, verdict, findings"))
    for place, text in ends:
        axes.text(place, 2.42, text, ha="center", fontsize=10, style="italic", color=INK)
    _arrow(axes, (middles[0], 2.36), (middles[0], 2.12))
    _arrow(axes, (middles[-1], 2.12), (middles[-1], 2.36))


def _show_mask(axes: Axes, mask: np.ndarray) -> None:
    shade = 1.0 - (1.0 - int(MASK[1:3], 16) / 255.0) * np.clip(mask, 0.0, 1.0)
    axes.imshow(shade, cmap="gray", vmin=0.0, vmax=1.0)


def _show_points(axes: Axes, pixels: np.ndarray) -> None:
    axes.scatter(*pixels.T, s=1.6, color=POINTS, linewidths=0)


def _show_pairs(axes: Axes, inside: np.ndarray, pixels: np.ndarray) -> None:
    """Join uncovered cells and nearest points, and points outside the mask and nearest cells."""
    rows, columns = np.nonzero(inside)
    centres = np.stack([columns, rows], 1).astype(float)
    distance, owner = cKDTree(pixels).query(centres)
    uncovered = distance > COVERED_WITHIN
    cell = np.rint(pixels).astype(int).clip(0, CELLS - 1)
    outside = ~inside[cell[:, 1], cell[:, 0]]
    _, nearest = cKDTree(centres).query(pixels[outside])
    far = np.flatnonzero(uncovered)[::2]
    for starts, ends, colour in (
        (pixels[owner[far]], centres[far], MISSING),
        (pixels[outside], centres[nearest], WRONG),
    ):
        axes.plot(*np.stack([starts, ends]).transpose(2, 0, 1), color=colour, lw=0.5)
    axes.scatter(*centres[uncovered].T, s=3.0, marker="s", color=MISSING, label="uncovered cell")
    axes.scatter(*pixels[outside].T, s=3.0, color=WRONG, label="point outside")
    axes.set_xlim(-0.5, CELLS - 0.5)
    axes.set_ylim(CELLS - 0.5, -0.5)
    axes.legend(
        loc="upper left",
        fontsize=6.5,
        markerscale=2.0,
        frameon=False,
        handletextpad=0.0,
        borderaxespad=0.0,
    )


# ---------------------------------------------------------------------------------- conventions


def draw_conventions(path: Path) -> None:
    """World and camera axes, pixel centres, and the window around an object."""
    figure, (axes, pixels, window) = plt.subplots(
        1, 3, figsize=(13.0, 3.9), dpi=110, width_ratios=(1.3, 1.05, 1.0)
    )
    _draw_cameras(axes)
    _draw_pixels(pixels)
    _draw_window(window)
    figure.tight_layout(w_pad=1.5)
    figure.savefig(path)
    plt.close(figure)


def _draw_cameras(axes: Axes) -> None:
    """A world with y up, and a camera that looks at its origin, seen obliquely from above."""
    position = np.array([0.0, 0.6, 3.3])
    forward = -position / np.linalg.norm(position)
    right = np.cross(forward, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    R = np.stack([right, np.cross(forward, right), forward])  # rows: x right, y down, z forward
    # How this figure itself is seen: from the side and above.
    side = np.radians(62.0)
    flat = np.array([[np.cos(side), 0.0, -np.sin(side)], [0.24, 0.97, 0.18]])

    def at(point: np.ndarray) -> np.ndarray:
        return flat @ point

    edges = [(a, b) for a in _cube() for b in _cube() if np.abs(a - b).sum() == 1.0]
    for a, b in edges:
        axes.plot(*np.stack([at(0.9 * a), at(0.9 * b)]).T, color="#9aa5b1", lw=1.0)
    _triad(axes, at, np.zeros(3), np.eye(3), 0.95, "world")
    _triad(axes, at, position, R, 0.75, "camera")
    # The picture in front of the camera, and the ray of one corner of the object.
    corner = 0.45 * np.array([1.0, 1.0, 1.0])
    across, down, depth = 0.62, 0.5, 1.2
    frame = [
        position + R.T @ [across * x, down * y, depth]
        for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1))
    ]
    axes.plot(*np.stack([at(p) for p in frame]).T, color=INK, lw=1.2)
    axes.plot(*np.stack([at(position), at(corner)]).T, color=WRONG, lw=1.0, ls="--")
    seen = R @ (corner - position)
    hit = position + R.T @ (seen * depth / seen[2])
    axes.scatter(*at(corner), color=WRONG, s=22, zorder=5)
    axes.scatter(*at(hit), color=WRONG, s=22, zorder=5)
    axes.annotate("X_world", at(corner), (4, 7), textcoords="offset points", fontsize=9)
    axes.annotate("pixel (u, v)", at(hit), (5, 6), textcoords="offset points", fontsize=9)
    axes.set_title("world -> camera -> pixel", fontsize=11)
    text = "X_camera = R X_world + t\nu = fx x / z + cx,   v = fy y / z + cy"
    axes.text(0.4, -0.06, text, transform=axes.transAxes, ha="center", fontsize=10, va="bottom")
    axes.set_aspect("equal")
    axes.margins(0.05, 0.12)
    axes.axis("off")


def _cube() -> list[np.ndarray]:
    return [np.array([x, y, z]) - 0.5 for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)]


def _triad(axes: Axes, at, origin: np.ndarray, rows: np.ndarray, size: float, name: str) -> None:
    """Three arrows along ``rows``, each with its name."""
    meaning = {"x": "x right", "y": "y down", "z": "z forward"} if name == "camera" else {}
    for axis, row in zip("xyz", rows, strict=True):
        end = at(origin + size * row)
        _arrow(axes, at(origin), end, AXES[axis])
        way = end - at(origin)
        place = end + 0.14 * way / max(np.linalg.norm(way), 0.3)
        axes.text(
            *place, meaning.get(axis, axis), color=AXES[axis], fontsize=10, ha="center", va="center"
        )
    axes.annotate(
        name,
        at(origin),
        (-10, 8) if name == "camera" else (6, -14),
        textcoords="offset points",
        fontsize=10,
        style="italic",
        ha="right" if name == "camera" else "left",
    )


def _draw_pixels(axes: Axes) -> None:
    """A picture of 6 x 4 pixels with the coordinates of centres and edges."""
    width, height = 6, 4
    for edge in np.arange(width + 1) - 0.5:
        axes.plot([edge, edge], [-0.5, height - 0.5], color="#9aa5b1", lw=0.8)
    for edge in np.arange(height + 1) - 0.5:
        axes.plot([-0.5, width - 0.5], [edge, edge], color="#9aa5b1", lw=0.8)
    columns, rows = np.meshgrid(np.arange(width), np.arange(height))
    axes.scatter(columns, rows, s=10, color=POINTS)
    axes.text(0.06, -0.1, "(0, 0)", fontsize=8, ha="left")
    axes.text(width - 1.06, height - 1.12, "(5, 3)", fontsize=8, ha="right")
    _arrow(axes, (-0.5, -0.85), (2.2, -0.85))
    axes.text(2.4, -0.85, "u: column", va="center", fontsize=10)
    _arrow(axes, (-0.85, -0.5), (-0.85, 1.6))
    axes.text(-0.85, 1.8, "v: row", ha="center", va="top", rotation=90, fontsize=10)
    axes.text(-0.5, height - 0.3, "u = -0.5", fontsize=9, ha="center", va="top")
    axes.text(width - 0.5, height - 0.3, "u = W - 0.5", fontsize=9, ha="center", va="top")
    axes.set_title("pixel centres lie at whole numbers (W = 6, H = 4)", fontsize=11)
    axes.set_xlim(-1.2, width + 0.1)
    axes.set_ylim(height + 0.4, -1.2)
    axes.set_aspect("equal")
    axes.axis("off")


def _draw_window(axes: Axes) -> None:
    """The square around mask and cloud in a larger photo."""
    mask = read_mask(CHAIR.parent / "photo" / "mask.png")
    height, width = mask.shape
    camera: Camera = read_camera(CHAIR.parent / "photo" / "camera.json", width, height)
    points = read_cloud(CHAIR / "initial.ply").points
    left, top, right, bottom = window_of(View(mask, camera), points)
    enlarged = axes.inset_axes((0.03, 0.28, 0.6, 0.69), anchor="E")
    for part in (axes, enlarged):
        _show_mask(part, mask)
        part.add_patch(
            Rectangle((left, top), right - left, bottom - top, fill=False, ec=WRONG, lw=1.4)
        )
        part.set_xticks([])
        part.set_yticks([])
    enlarged.scatter(*camera.project(points)[0].T, s=1.0, color=POINTS, linewidths=0)
    for share in np.linspace(0.0, 1.0, CELLS + 1)[4:-1:4]:
        enlarged.plot([left + share * (right - left)] * 2, [top, bottom], color=WRONG, lw=0.25)
        enlarged.plot([left, right], [top + share * (bottom - top)] * 2, color=WRONG, lw=0.25)
    room = 0.04 * (right - left)
    enlarged.set_xlim(left - room, right + room)
    enlarged.set_ylim(bottom + room, top - room)
    for edge, height_share in ((top, 0.97), (bottom, 0.28)):
        inset_corner = (0.63 * width - 0.5, (1.0 - height_share) * height - 0.5)
        axes.plot(*zip(inset_corner, (left, edge), strict=True), color=INK, lw=0.6)
    axes.set_xlabel(
        "the window: a square of 64 x 64 cells around mask\n"
        "and cloud, with a margin of 1/8 of the longer side",
        fontsize=9,
        color=WRONG,
    )
    axes.set_title(f"window in a photo of {width} x {height} pixels", fontsize=11)


def _arrow(axes: Axes, start, end, colour: str = INK) -> None:
    axes.annotate("", end, start, arrowprops={"arrowstyle": "-|>", "color": colour, "lw": 1.5})


# ---------------------------------------------------------------------------------- families


def draw_families(path: Path) -> None:
    """Forty shapes by rule: the first of each family, then the second of some."""
    figure = plt.figure(figsize=(13.0, 7.2), dpi=80)
    names = list(FAMILIES)
    chosen = [(names[i % len(names)], i // len(names)) for i in range(ROWS * COLUMNS)]
    for number, (family, seed) in enumerate(chosen):
        row, column = divmod(number, COLUMNS)
        box = (column / COLUMNS, 1.0 - (row + 1) / ROWS, 1.0 / COLUMNS, 0.85 / ROWS)
        axes = figure.add_axes(box)
        axes.set_title(family, fontsize=9.0, pad=2.0)
        axes.imshow(_shaded(shape_of(family, [seed])), cmap="gray", vmin=0.0, vmax=1.0)
        axes.axis("off")
    figure.savefig(path)
    plt.close(figure)


def _shaded(mesh: Mesh) -> np.ndarray:
    """A picture [SIDE, SIDE] of a mesh: brighter where it faces the light."""
    camera = look_at(35.0, 20.0, 2.5, (SIDE, SIDE))
    hits = RayScene(mesh).cast(camera, np.arange(float(SIDE)), np.arange(float(SIDE)))
    light = np.array([0.5, 0.7, 0.5]) / np.linalg.norm([0.5, 0.7, 0.5])
    return np.where(hits["hit"], 0.25 + 0.6 * np.abs(hits["normal"] @ light), 1.0)


def main(folder: Path) -> None:
    draw_families(folder / "families.png")
    draw_pipeline(folder / "pipeline.png")
    draw_conventions(folder / "conventions.png")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else DOCS)
