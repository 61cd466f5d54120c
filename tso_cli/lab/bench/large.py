"""Large scenes by command: a scan in a photo of 12 megapixels, a file of Gaussian splats, a mesh of many faces."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path

import numpy as np
import trimesh

from ...geometry.resampling import area_resize
from ...io.cameras import CameraRecord, write_cameras
from ...io.images import write_image
from ...io.meshes import read_mesh
from ..study import Cases
from .refining import CHAIR, START, TSO, chair_views, cloud
from .timing import IMPORT_TORCH, Contestant, Setting, process

# Pixels of the photo, of which the object fills a part.
WIDTH, HEIGHT = 4000, 3000
SCAN, SPLATS, FACES = 2_000_000, 100_000, 500_000
# Of a splat, as the reference implementation of Gaussian splatting writes them; its colours of higher order are left out.
PROPERTIES = [
    "x",
    "y",
    "z",
    "nx",
    "ny",
    "nz",
    "f_dc_0",
    "f_dc_1",
    "f_dc_2",
    "opacity",
    "scale_0",
    "scale_1",
    "scale_2",
]
PROPERTIES += [f"rot_{number}" for number in range(4)]
# The command, then the peak of its process's memory.
WATCHED = """from tso_cli.__main__ import main
try:
    main()
finally:
    import json
    from tso_cli.lab.bench.timing import peak_memory
    open({!r}, "w").write(json.dumps(peak_memory()))
"""


def measure_large(
    setting: Setting, scan: int = SCAN, splats: int = SPLATS, faces: int = FACES
) -> Cases:
    """Whole processes of `tso refine`, and the memory that they take; TsoError if one fails."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        _write_photo(folder)
        np.save(folder / "scan.npy", cloud(scan, setting.seed).astype(np.float32))
        (folder / "splats.ply").write_bytes(splat_file(splats, setting.seed))
        mesh = finer_mesh(faces)
        mesh.export(folder / "mesh.ply")
        scenes = {
            "scan": ("scan.npy", folder / "mask.png", scan),
            "splats": ("splats.ply", CHAIR / "mask.png", splats),
            "mesh": ("mesh.ply", CHAIR / "mask.png", len(mesh.faces)),
        }
        contestants, peaks = [IMPORT_TORCH], []
        for scene, (start, mask, points) in scenes.items():
            words = ("refine", "--mode", "points", str(folder / start), str(mask))
            contestants.append(
                Contestant(scene, process(scene, (*TSO, *words)), {"points": points})
            )
            peaks.append(_peak(folder / "peak", scene, words))
        records = setting.race("large", contestants, "over_import_torch")
        return [
            records[0],
            *(row | {"peak_MiB": peak} for row, peak in zip(records[1:], peaks, strict=True)),
        ]


def _write_photo(folder: Path) -> None:
    """The view of the shipped chair in a photo of this size."""
    (view,) = chair_views()
    side = view.camera.height
    aside = (side * WIDTH / HEIGHT - side) / 2.0
    box = (-0.5 - aside, -0.5, side - 0.5 + aside, side - 0.5)
    mask, _ = area_resize(view.mask, box, WIDTH, HEIGHT)
    write_image(folder / "mask.png", np.uint8(255.0 * (mask > 0.5)))
    write_cameras(
        folder / "mask.camera.json", [CameraRecord(view.camera.cropped(box, WIDTH, HEIGHT))]
    )


def splat_file(count: int, seed: int) -> bytes:
    """A PLY file of so many splats."""
    values = np.random.default_rng(seed).normal(size=(count, len(PROPERTIES))).astype("<f4")
    values[:, :3] = cloud(count, seed)
    lines = [
        "ply",
        "format binary_little_endian 1.0",
        f"element vertex {count}",
        *(f"property float {p}" for p in PROPERTIES),
    ]
    return "\n".join([*lines, "end_header", ""]).encode() + values.tobytes()


def finer_mesh(faces: int) -> trimesh.Trimesh:
    """The shape that clouds are sampled from, its faces divided until there are so many."""
    start = read_mesh(START)
    mesh = trimesh.Trimesh(start.vertices, start.faces, process=False)
    while len(mesh.faces) < faces:
        mesh = mesh.subdivide()
    return mesh


def _peak(file: Path, name: str, arguments: tuple[str, ...]) -> int | None:
    """MiB at most in the process of a command; None but on Linux."""
    process(name, ("-c", WATCHED.format(str(file)), *arguments))()
    peak: int | None = json.loads(file.read_text())
    return peak
