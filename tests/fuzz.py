"""Coverage-guided damage to files: `python -m tests.fuzz READER SECONDS [CORPUS]`, with atheris on
the path.

A reader must read a file or raise InputError with one line that names it, within 5 seconds and 1
GiB; the first file that makes it do anything else is left as crash-*. Without READER the readers
are listed.
"""

import pkgutil
import sys
import tempfile
from importlib import import_module
from pathlib import Path

import numpy as np

from tests.corruption import is_read
from tso_cli.errors import InputError, TsoError

# Suffixes of clouds, and of meshes whose vertices are one.
CLOUDS = (
    ".ply", ".npy", ".npz", ".pt", ".xyz", ".txt", ".csv", ".pts", ".pcd", ".glb", ".gltf", ".obj",
    ".off", ".stl",
)  # fmt: skip
READERS = {
    # A cloud is moved and written again too; the suffix says where binary files differ from text.
    **{f"cloud{suffix}": ("tests.fuzz:moved", suffix) for suffix in CLOUDS},
    "cloud.binary.pcd": ("tests.fuzz:moved", ".pcd"),
    "cloud.binary.stl": ("tests.fuzz:moved", ".stl"),
    **{
        f"mesh{suffix}": ("io.meshes:read_mesh", suffix)
        for suffix in (".ply", ".obj", ".off", ".stl", ".glb")
    },
    **{
        f"mask{suffix}": ("io.masks:read_mask", suffix)
        for suffix in (
            ".png",
            ".tif",
            ".jpg",
            ".gif",
            ".webp",
            ".npy",
            ".npz",
            ".pt",
            ".json",
            ".xml",
            ".txt",
        )
    },
    "mask.sam.npz": ("io.masks:read_mask", ".npz"),
    "mask.coco.json": ("tests.fuzz:first_mask", ".json"),
    "mask.label.png": ("tests.fuzz:first_label", ".png"),
    "faces": ("tests.fuzz:faces", ".ply"),
    "image": ("io.images:read_image", ".bmp"),
    "depth": ("io.depth_maps:read_depth", ".png"),
    "depth.npy": ("io.depth_maps:read_depth", ".npy"),
    "grid.npy": ("io.shapes:grid_surface", ".npy"),
    "grid.binvox": ("io.shapes:grid_surface", ".binvox"),
    "camera": ("io.cameras:read_cameras", ".json"),
    **{
        f"camera{suffix}": ("tests.fuzz:cameras", suffix)
        for suffix in (".json", ".yaml", ".xml", ".npz", ".npy", ".txt", ".glb", ".log")
    },
    # The other file of the model is a good one.
    "camera/cameras.bin": ("tests.fuzz:model", "/cameras.bin"),
    "camera/images.bin": ("tests.fuzz:model", "/images.bin"),
    "camera/images.txt": ("tests.fuzz:model", "/images.txt"),
    "checkpoint": ("io.checkpoints:load_network", ".safetensors"),
    "state": ("tests.fuzz:state", ".safetensors"),
    "log": ("io.logs:read_log", ".jsonl"),
    "split": ("datasets.splits:read_split", ".json"),
    "record": ("tso_lab.commands.records:read_record", ".json"),
}


def reader(name):
    """What reads files for ``name``, and their suffix."""
    place, suffix = READERS[name]
    module, function = place.split(":")
    module = module if module.startswith(("tests", "tso_lab")) else f"tso_cli.{module}"
    return getattr(__import__(module, fromlist=["x"]), function), suffix


def moved(path):
    """A cloud, with its faces, moved and written again."""
    from tso_cli.io.clouds import output_suffix, read_cloud, write_cloud

    cloud = read_cloud(path)
    cloud.faces()
    if cloud.source is not None:
        cloud.source.require_movable()
    try:
        target = path.with_name(f"moved {path.name}{output_suffix(path)}")
        write_cloud(target, cloud.points + 0.5, like=cloud, overwrite=True)
    except TsoError as error:  # a coordinate too large for its type
        raise InputError(str(error)) from None


def first_mask(path):
    """The first of several masks."""
    from tso_cli.io.masks import MaskChoice, read_mask

    read_mask(path, MaskChoice(index=0))


def first_label(path):
    """The pixels of one label."""
    from tso_cli.io.masks import MaskChoice, read_mask

    read_mask(path, MaskChoice("1"))


def faces(path):
    """A cloud, its colours, and its faces with their paint at one point of each."""
    from tso_cli.io.clouds import read_cloud

    cloud = read_cloud(path)
    faces, paint = cloud.faces(), cloud.paint()
    cloud.colours()
    if faces is not None and paint is not None:
        paint.at(np.arange(len(faces)), np.full((len(faces), 3), 1.0 / 3.0))


def cameras(path):
    """The cameras in a file of any format, as far as it says them."""
    from tso_cli.io.cameras import read_partial_cameras

    for view in read_partial_cameras(path)[0]:
        if view.intrinsics is not None and view.R is not None:
            view.camera(path, *(view.size or (64, 64)))


def model(path):
    """The cameras of a COLMAP model, one of whose files is ``path``."""
    for good in (Path(__file__).with_name("io") / "files/colmap/sparse/0").iterdir():
        other = path.with_name(good.name)
        if good.stem != path.stem and not other.exists():
            other.write_bytes(good.read_bytes())
    cameras(path)


def state(path):
    """The training state in a file."""
    from tso_cli.io.checkpoints import load_state, read_metadata

    step = read_metadata(path)[1].get("step")
    load_state(path, {"history": (step, 4)} if isinstance(step, int) else {})


def main(name, seconds, *corpus):
    """Fuzz one reader."""
    import atheris

    with atheris.instrument_imports(include=["tso_cli", "trimesh", "PIL"]):
        # What readers import when they are called.
        import PIL.TiffImagePlugin  # noqa: F401
        import trimesh  # noqa: F401

        from tso_cli.io import (  # noqa: F401
            archives,
            cameras,
            checkpoints,
            clouds,
            gltf,
            images,
            masks,
            meshes,
            obj,
            point_tables,
        )

        for module in pkgutil.iter_modules(cameras.__path__):
            import_module(f"{cameras.__name__}.{module.name}")
        read, suffix = reader(name)
    images.PIXEL_LIMIT = 1 << 24  # a picture takes up to 16 bytes for each pixel
    path = Path(f"{tempfile.mkdtemp()}/victim{suffix}")
    path.parent.mkdir(exist_ok=True)

    def test(data):
        path.write_bytes(data)
        is_read(read, path)

    limits = ["-timeout=5", "-rss_limit_mb=1024", "-max_len=20000", f"-max_total_time={seconds}"]
    atheris.Setup([sys.argv[0], *limits, *corpus], test)
    atheris.Fuzz()


if __name__ == "__main__":
    if len(sys.argv) < 3:
        print(*READERS)
    else:
        main(*sys.argv[1:])
