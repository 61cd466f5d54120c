"""The points variant on arrays: a cloud, a mask and a camera in, a refined cloud out."""

from pathlib import Path

from tso_cli import Camera, refine
from tso_cli.evaluation.metrics import chamfer
from tso_cli.io.cameras import read_cameras
from tso_cli.io.clouds import read_cloud
from tso_cli.io.images import read_mask

chair = Path(__file__).parent / "chair"
points, target = (
    read_cloud(chair / name).points for name in ("initial.ply", "target.ply")
)  # [N, 3] arrays
camera: Camera = read_cameras(chair / "camera.json")[0].camera

result = refine(points, read_mask(chair / "mask.png"), camera)

print(f"IoU           {result.iou_before:.3f} -> {result.iou_after:.3f}")
before, after = (chamfer(cloud, target).chamfer for cloud in (points, result.points))
print(
    f"Chamfer x1000 {1e3 * before:.2f} -> {1e3 * after:.2f} (squared, mean over points, both directions)"
)
