"""`tso refine --crop` writes the object alone."""

import numpy as np
import pytest

from tests.cloud.test_left_out import CHAIR, with_floor
from tests.scenes import EXAMPLES
from tso_cli.io.clouds import read_cloud, write_cloud


def test_the_floor_is_not_written_and_counted_as_json(folder, refine):
    cloud = with_floor(CHAIR.target)
    write_cloud(folder / "scan.ply", cloud)
    for name in ("mask.png", "camera.json"):
        source = EXAMPLES / "chair" / name
        (folder / f"chair.{name}").write_bytes(source.read_bytes())
    words = ("scan.ply", "chair.mask.png", "--camera", "chair.camera.json", "--crop")
    document = refine(*words, "-o", "all.ply", "--json").document
    written = read_cloud(folder / "all.ply").points
    assert len(written) == document["points"] - document["outliers"]
    assert document["outliers"] > 0.95 * (len(cloud) - len(CHAIR.target))
    run = refine(*words, "-o", "again.ply")
    assert run.out.startswith(f"again.ply: {len(written):,} points")
    assert "lie outside the masks, which the others fit" in run.err
    assert np.isin(written[:, 0], cloud[:, 0].astype(np.float32)).all()


def test_without_such_points_all_are_written(folder, refine):
    refine("initial.ply", "mask.png", "--crop", "-o", "out.ply")
    assert len(read_cloud("out.ply").points) == len(read_cloud("initial.ply").points)


@pytest.mark.parametrize("name", ["scan.glb", "scan.obj"])
def test_a_format_that_is_written_whole_is_refused_before_any_file_is_read(folder, refine, name):
    run = refine(name, "mask.png", "--crop")
    assert "for --crop; write another file: -o scan.refined.ply" in run.err
