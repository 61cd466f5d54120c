"""Refine what a network predicts from a photo: the shipped network, or one from `tso train`.

python examples/refine_network.py [base.safetensors]
"""

import sys
from pathlib import Path

from tso_cli import RefineConfig, refine
from tso_cli.evaluation.metrics import chamfer
from tso_cli.geometry.points import normalise_longest_side
from tso_cli.io.clouds import read_cloud
from tso_cli.io.shipped import named_checkpoint
from tso_cli.scene.network import load_network_scene

chair = Path(__file__).parent / "chair"
target = normalise_longest_side(read_cloud(chair / "target.ply").points)
checkpoint = named_checkpoint(Path(sys.argv[1] if len(sys.argv) > 1 else "default"))
scene = load_network_scene(chair / "image.png", chair / "mask.png", checkpoint, world=True)

for mode in ("encoder", "encoder-decoder"):
    config = RefineConfig(mode=mode)
    result = refine(None, scene.view, config=config, network=scene.network, image=scene.image)
    # A network knows neither size nor place, so both clouds are compared at longest side 1.
    clouds = (
        normalise_longest_side(scene.to_output(points))
        for points in (result.initial, result.points)
    )
    before, after = (1e3 * chamfer(cloud, target).chamfer for cloud in clouds)
    fit = result.fit
    print(f"{mode}:")
    print(f"  IoU           {fit.iou_before:.3f} -> {fit.iou_after:.3f}")
    print(f"  Chamfer x1000 {before:.3f} -> {after:.3f}")
