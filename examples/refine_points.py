"""Refine a cloud from Python: points, a mask and a camera in, a refined cloud out."""

from pathlib import Path

from tso_cli import refine
from tso_cli.evaluation.metrics import chamfer
from tso_cli.io.cameras import read_camera
from tso_cli.io.clouds import read_cloud
from tso_cli.io.masks import read_mask

chair = Path(__file__).parent / "chair"
points = read_cloud(chair / "initial.ply").points  # [N, 3]
target = read_cloud(chair / "target.ply").points
mask = read_mask(chair / "mask.png")  # [H, W] from 0 to 1
camera = read_camera(chair / "camera.json", width=256, height=256)

result = refine(points, mask, camera)

print(f"IoU           {result.fit.iou_before:.3f} -> {result.fit.iou_after:.3f}")
before, after = (chamfer(cloud, target).chamfer for cloud in (points, result.points))
# Squared distances, mean over points, both directions added.
print(f"Chamfer x1000 {1e3 * before:.2f} -> {1e3 * after:.2f}")
