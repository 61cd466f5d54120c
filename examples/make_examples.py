"""Make the shipped examples from a folder of CC0 meshes.

    python examples/make_examples.py --meshes DIR [--output examples]

DIR has an index.csv with the columns file, category, source, credit and licence.

An example is a picture of one shape (image, mask, camera, 1,024 surface points), and another shape
of the category as the start. Chairs and cars are turned to face +z, aeroplanes -x. y is up.
"""

from __future__ import annotations

import argparse
import csv
import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np

from tso_cli.errors import InputError, TsoError
from tso_cli.geometry.rotations import from_vectors
from tso_cli.io.cameras import CameraRecord, write_cameras
from tso_cli.io.clouds import write_cloud
from tso_cli.io.images import write_image
from tso_cli.io.meshes import Mesh, read_mesh, write_mesh
from tso_cli.render.folder import ground_truth
from tso_cli.render.normalise import normalise
from tso_cli.render.rays import RayScene, render_view
from tso_cli.render.settings import RenderSettings
from tso_cli.render.viewpoints import fitting_distance, look_at

SIZE = (256, 256)
# A photo in which the chair is small: its size, focal length and principal point, px.
PHOTO, FOCAL, MIDDLE = (1280, 960), 210.0, (923.5, 567.5)

# A cloud in a wrong place: rotation vector in degrees, and shift in longest sides.
TURN, SHIFT = (5.0, 6.0, -4.0), (0.05, -0.03, 0.02)

# Category: target, initial (the other shape), azimuth and elevation of the picture in degrees.
EXAMPLES = {
    "chair": ("BlendSwap-CC-0_chair", "q17_ChairHandle", 35.0, 20.0),
    "car": ("qreal_SportsCar", "qreal_Cop_SUV", -50.0, 18.0),
    "airplane": ("qplane_Commercial_Airplane", "qplane_Private_plane", -40.0, 30.0),
}

# Meshes to train on; no target of an example is among them.
TRAINING = {
    "chair": (
        "BlendSwap-CC-0_osakaChair kfurn_chair kfurn_chairCushion kfurn_chairDesk "
        "kfurn_chairRounded q17_Chair q17_ChairCushioned q17_ChairHandle q19_Chair "
        "q19_OfficeChair"
    ),
    "car": (
        "qbasic_BasicCar qbasic_CopCar qbasic_RaceCar qbasic_SimpleCarHigh qpublic_Taxi "
        "qreal_Cop qreal_NormalCar1 qreal_NormalCar2 qreal_SUV qreal_SportsCar2"
    ),
    "airplane": (
        "BlendSwap-CC-0_cartoon_biplane qplane_MilitaryAirplane2 qplane_Military_Airplane "
        "qplane_Private_plane qplane_SmallPlane"
    ),
}

# Degrees about y that turn a mesh to face as its category does, by the beginning of the mesh's
# name. They were found by looking at pictures.
TURNS = {
    "kfurn_": 180,
    "q17_": -90,
    "qreal_": 180,
    "BlendSwap-CC-0_cartoon_biplane": -90,
    "qplane_Military": -90,
    "qplane_SmallPlane": -90,
    "qplane_Private": 90,
}


def turned(name: str, mesh: Mesh) -> Mesh:
    """``mesh``, turned to face as its category does. Quarter turns are exact."""
    degrees = next((value for start, value in TURNS.items() if name.startswith(start)), 0)
    cos, sin = {0: (1, 0), 90: (0, 1), 180: (-1, 0), -90: (0, -1)}[degrees]
    turn = np.array([[cos, 0, sin], [0, 1, 0], [-sin, 0, cos]], dtype=np.float64)
    return Mesh(mesh.vertices @ turn.T, mesh.faces)


def make_example(
    folder: Path, target: Mesh, initial: Mesh, azimuth: float, elevation: float
) -> None:
    """Write image.png, mask.png, camera.json, target.ply and initial.ply."""
    target, initial = normalise(target), normalise(initial)
    camera = look_at(azimuth, elevation, 2.0, SIZE)
    camera = look_at(
        azimuth, elevation, fitting_distance(target.vertices, camera, margin=8.0), SIZE
    )
    view = render_view(RayScene(target), camera)
    write_image(folder / "image.png", view.image, overwrite=True)
    write_image(folder / "mask.png", view.mask, overwrite=True)
    write_cameras(folder / "camera.json", [CameraRecord(camera, None, None)], overwrite=True)
    for name, mesh in (("target", target), ("initial", initial)):
        rng = np.random.default_rng(zlib.crc32(f"{folder.name}/{name}".encode()))
        _, points = ground_truth(mesh, RenderSettings(), rng)
        write_cloud(folder / f"{name}.ply", points.astype(np.float32), overwrite=True)


def make_misplaced(path: Path, target: Mesh) -> None:
    """Write other points of the true shape, in a wrong place."""
    rng = np.random.default_rng(zlib.crc32(b"misplaced"))
    _, points = ground_truth(normalise(target), RenderSettings(), rng)
    points = points @ from_vectors(np.radians(TURN)).T + SHIFT
    write_cloud(path, points.astype(np.float32), overwrite=True)


def make_photo(folder: Path, target: Mesh, azimuth: float, elevation: float) -> None:
    """Write mask.png and camera.json of a large photo from the place of the example's picture."""
    target = normalise(target)
    camera = look_at(azimuth, elevation, 2.0, SIZE)
    camera = look_at(
        azimuth, elevation, fitting_distance(target.vertices, camera, margin=8.0), SIZE
    )
    K = np.array([[FOCAL, 0.0, MIDDLE[0]], [0.0, FOCAL, MIDDLE[1]], [0.0, 0.0, 1.0]])
    camera = replace(camera, K=K, width=PHOTO[0], height=PHOTO[1])
    write_image(folder / "mask.png", render_view(RayScene(target), camera).mask, overwrite=True)
    write_cameras(folder / "camera.json", [CameraRecord(camera, None, None)], overwrite=True)


def credits_table(rows: list[tuple[str, dict[str, str]]]) -> str:
    """CREDITS.md: one line a shipped file or folder of files."""
    lines = [
        "# Credits",
        "",
        "All shapes are in the public domain under CC0 1.0 "
        "(https://creativecommons.org/publicdomain/zero/1.0/). The pictures,",
        "masks, cameras and clouds were made from them by `make_examples.py` and are given under "
        "the same terms.",
        "The authors: Kenney (www.kenney.nl), Quaternius (www.patreon.com/quaternius), and the "
        "authors of the BlendSwap shapes",
        "that the Debian package sweethome3d-furniture distributes.",
        "",
        "| file | made from | author | source | licence |",
        "|---|---|---|---|---|",
    ]
    for shipped, row in rows:
        lines.append(
            f"| {shipped} | {row['file']} | {row['credit']} | {row['source']} | {row['licence']} |"
        )
    return "\n".join(lines) + "\n"


def make(meshes: Path, output: Path) -> None:
    """Write every example, the training meshes and CREDITS.md into ``output``."""
    index = meshes / "index.csv"
    try:
        rows = {
            row["file"]: row
            for row in csv.DictReader(index.read_text(encoding="utf-8").splitlines())
        }
    except (OSError, UnicodeError, KeyError):
        raise InputError(
            f"{index}: not readable, expected a table with file, category, source, credit, licence"
        ) from None
    shipped: list[tuple[str, dict[str, str]]] = []

    def load(category: str, name: str) -> tuple[Mesh, dict[str, str]]:
        row = rows.get(f"{category}/{name}.ply")
        if row is None or row["licence"] != "CC0-1.0":
            raise InputError(f"{index}: {category}/{name}.ply is not listed there under CC0-1.0")
        return turned(name, read_mesh(meshes / row["file"])), row

    for category, (target, initial, azimuth, elevation) in EXAMPLES.items():
        (target_mesh, target_row), (initial_mesh, initial_row) = (
            load(category, target),
            load(category, initial),
        )
        folder = output / category
        folder.mkdir(parents=True, exist_ok=True)
        make_example(folder, target_mesh, initial_mesh, azimuth, elevation)
        shipped.append((f"{category}/image.png, mask.png, target.ply", target_row))
        shipped.append((f"{category}/initial.ply", initial_row))
        if category == "chair":
            folder = output / "photo"
            folder.mkdir(parents=True, exist_ok=True)
            make_photo(folder, target_mesh, azimuth, elevation)
            shipped.append(("photo/mask.png", target_row))
            make_misplaced(output / category / "misplaced.ply", target_mesh)
            shipped.append((f"{category}/misplaced.ply", target_row))
    for category, names in TRAINING.items():
        folder = output / "meshes" / category
        folder.mkdir(parents=True, exist_ok=True)
        for name in names.split():
            mesh, row = load(category, name)
            write_mesh(folder / f"{name}.ply", mesh, overwrite=True)
            shipped.append((f"meshes/{category}/{name}.ply", row))
    (output / "CREDITS.md").write_text(credits_table(shipped), encoding="utf-8")


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument(
        "--meshes", type=Path, required=True, help="folder with index.csv and the meshes it lists"
    )
    parser.add_argument(
        "--output", type=Path, default=Path(__file__).resolve().parent, help="where to write (here)"
    )
    arguments = parser.parse_args()
    try:
        make(arguments.meshes, arguments.output)
    except TsoError as error:
        parser.exit(error.exit_code, f"{error}\n")


if __name__ == "__main__":
    main()
