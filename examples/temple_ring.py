"""Make the input of `tso refine` from photos on a dark ground, and evaluate by other photos.

The photos are not part of this repository. docs/photos.md says where they are from.

Make masks, views.json and start.ply:
    python examples/temple_ring.py prepare templeRing temple
Refine with some of the masks, and evaluate the result with the others:
    tso refine temple/start.ply temple/templeR0013.png ... --camera temple/views.json \\
        -o temple/refined.ply
    python examples/temple_ring.py judge temple temple/refined.ply --used templeR0013 ...
Compare two starts, 1, 2 and 4 masks, and both presets:
    python examples/temple_ring.py compare temple -o photos.json
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from tso_cli import Camera, RefineConfig, refine
from tso_cli.evaluation.footprint import IOU_MEANS, Solid, window_iou
from tso_cli.geometry.view import View
from tso_cli.io.cameras import CameraRecord, read_cameras, write_cameras
from tso_cli.io.clouds import read_cloud, write_cloud
from tso_cli.io.images import read_image, write_image
from tso_cli.io.masks import read_mask
from tso_lab.studies.fingerprint import today

Array = NDArray[np.float64]

# Brightness that only the object reaches. The stand under it is darker.
THRESHOLD = 70
# The object's box by the description of the data, and the room around it, in sizes of the box.
BOX = np.array([[-0.023121, -0.038009, -0.091940], [0.078626, 0.121636, -0.017395]])
ROOM = 0.1
# Cells along the longest side of the coarse hull, the points drawn on it, and their noise in
# longest sides.
CELLS, POINTS, NOISE = 24, 2048, 0.03


def mask_of(image: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """The largest bright thing in a picture [H, W, 3]. Its holes, which are shadows, are filled."""
    bright = ndimage.gaussian_filter(image[..., :3].max(2).astype(np.float64), 1.0) > THRESHOLD
    bright = ndimage.binary_closing(ndimage.binary_opening(bright, iterations=2), iterations=6)
    labels, count = ndimage.label(bright)
    if count == 0:
        raise SystemExit(
            f"no pixel is brighter than {THRESHOLD}, expected an object on a dark ground"
        )
    largest = 1 + int(np.argmax(np.bincount(labels.ravel())[1:]))
    filled: NDArray[np.bool_] = ndimage.binary_fill_holes(labels == largest)
    return filled


def read_parameters(path: Path) -> dict[str, tuple[Array, Array, Array]]:
    """Name of a photo -> K, R, t, from a Middlebury file: a count, then rows of "name K R t"."""
    rows = [line.split() for line in path.read_text().splitlines()[1:] if line.strip()]
    numbers = {row[0]: np.array(row[1:], dtype=np.float64) for row in rows}
    return {
        name: (n[:9].reshape(3, 3), n[9:18].reshape(3, 3), n[18:21]) for name, n in numbers.items()
    }


def spread(views: list[View], count: int) -> list[View]:
    """``count`` of the views, evenly from the first to the last."""
    return [views[i] for i in np.linspace(0, len(views) - 1, count).round().astype(int)]


def coarse_hull(views: list[View], rng: np.random.Generator) -> Array:
    """Points [POINTS, 3] on the surface of the cells that every mask shows, with noise."""
    low, high = BOX[0] - ROOM * np.ptp(BOX, 0), BOX[1] + ROOM * np.ptp(BOX, 0)
    side = float((high - low).max()) / CELLS
    axes = [np.arange(a + side / 2.0, b, side) for a, b in zip(low, high, strict=True)]
    centres = np.stack(np.meshgrid(*axes, indexing="ij"), -1)
    full = np.ones(centres.shape[:3], dtype=bool)
    for view in views:
        full &= inside(centres.reshape(-1, 3), view).reshape(full.shape)
    surface = centres[full & ~ndimage.binary_erosion(full)]
    if not len(surface):
        raise SystemExit(
            "the masks leave nothing of the box, expected masks and cameras of one object"
        )
    drawn = surface[rng.integers(len(surface), size=POINTS)] + rng.uniform(
        -side / 2.0, side / 2.0, (POINTS, 3)
    )
    noisy: Array = drawn + NOISE * np.ptp(drawn, 0).max() * rng.standard_normal((POINTS, 3))
    return noisy


def inside(points: Array, view: View) -> NDArray[np.bool_]:
    """Which of the points [N, 3] fall on the mask."""
    column, row = view.camera.project(points)[0].round().T
    height, width = view.mask.shape
    seen = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    found = np.zeros(len(points), dtype=bool)
    found[seen] = view.mask[row[seen].astype(int), column[seen].astype(int)] > 0.5
    return found


def read_views(folder: Path) -> list[View]:
    """All views that ``prepare`` wrote into a folder."""
    return [
        View(read_mask(r.mask), r.camera, name=r.mask.stem)
        for r in read_cameras(folder / "views.json")
        if r.mask
    ]


def prepare(photos: Path, folder: Path) -> None:
    """Write masks, camera file and start. Photos that are missing are left out."""
    (parameters,) = photos.glob("*_par.txt")
    folder.mkdir(parents=True, exist_ok=True)
    records = []
    for name, (K, R, t) in read_parameters(parameters).items():
        if not (photos / name).is_file():
            continue
        mask = mask_of(read_image(photos / name))
        write_image(folder / name, mask, overwrite=True)
        records.append(
            CameraRecord(Camera(K, R, t, mask.shape[1], mask.shape[0]), mask=folder / name)
        )
    write_cameras(folder / "views.json", records, overwrite=True)
    views = read_views(folder)
    middle = views[len(views) // 2]
    write_cloud(
        folder / "start.ply", coarse_hull([middle], np.random.default_rng(0)), overwrite=True
    )
    print(
        f"{folder}: {len(views)} masks, views.json, and start.ply, the box carved by {middle.name}"
    )


def judged(points: Array, views: list[View]) -> dict[str, float]:
    """IoU of a cloud's silhouette and the masks, and the share of its points outside a mask."""
    scores = [window_iou(Solid(points), view) for view in views]
    outside = [float((~inside(points, view)).mean()) for view in views]
    return {
        "iou": float(np.mean(scores)),
        "worst_iou": float(np.min(scores)),
        "beside": float(np.mean(outside)),
        "most_beside": float(np.max(outside)),
    }


def judge(folder: Path, cloud: Path, used: list[str]) -> None:
    """Print how start and refined cloud agree with the masks that were not used."""
    others = [view for view in read_views(folder) if view.name not in used]
    print(f"{len(others)} masks that were not used")
    for path in (folder / "start.ply", cloud):
        found = judged(read_cloud(path).points, others)
        print(
            f"{path}: IoU {found['iou']:.3f}, worst {found['worst_iou']:.3f}; "
            f"{found['beside']:.1%} of the points outside a mask, "
            f"at most {found['most_beside']:.1%}"
        )


def compare(folder: Path, output: Path) -> None:
    """Refine two starts with 1, 2 and 4 masks and both presets; evaluate with unused masks."""
    views = read_views(folder)
    middle, four = views[len(views) // 2], spread(views, 4)
    used = {view.name for view in (middle, *four)}
    others = [view for view in views if view.name not in used]
    rows = []
    for carved in ([middle], four):
        start = coarse_hull(carved, np.random.default_rng(0))
        begin = {"start": [view.name for view in carved]}
        rows.append(
            {**begin, "masks": [], "preset": None, "symmetry": None, **judged(start, others)}
        )
        for count in (1, 2, 4):
            own = spread(views, count)
            for preset, symmetry in (("paper", "none"), ("best", "none"), ("best", "auto")):
                result = refine(start, own, config=RefineConfig(preset=preset, symmetry=symmetry))
                row = {
                    **begin,
                    "masks": [view.name for view in own],
                    "preset": preset,
                    "symmetry": symmetry,
                }
                row |= judged(result.points, others)
                row |= {"iou_used_before": result.fit.iou_before, "iou_used": result.fit.iou_after}
                row |= {
                    "symmetry_plane": result.symmetry.coefficients,
                    "seconds": sum(result.cost.seconds.values()),
                }
                rows.append(row)
                print(json.dumps(row))
    record = {
        "study": "photos",
        "photos": len(views),
        "judged_by": [view.name for view in others],
        "points": POINTS,
        "noise": NOISE,
        "conventions": f"{IOU_MEANS}; seed 0; cpu",
        "summary": rows,
    }
    record["fingerprint"] = {part: today(part) for part in ("points, paper", "points, best")}
    output.write_text(json.dumps(record, indent=1) + "\n")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    tasks = parser.add_subparsers(dest="task", required=True)
    one = tasks.add_parser("prepare")
    one.add_argument("photos", type=Path)
    one.add_argument("folder", type=Path)
    two = tasks.add_parser("judge")
    two.add_argument("folder", type=Path)
    two.add_argument("cloud", type=Path)
    two.add_argument(
        "--used", nargs="+", required=True, help="names of the masks that the cloud was refined on"
    )
    three = tasks.add_parser("compare")
    three.add_argument("folder", type=Path)
    three.add_argument("-o", "--output", type=Path, required=True)
    given = parser.parse_args()
    if given.task == "prepare":
        prepare(given.photos, given.folder)
    elif given.task == "judge":
        judge(given.folder, given.cloud, given.used)
    else:
        compare(given.folder, given.output)


if __name__ == "__main__":
    main()
