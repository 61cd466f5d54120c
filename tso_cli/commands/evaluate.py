"""`tso eval`: judge clouds against ground truth."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import click

from ..errors import GateError, InputError
from ..evaluation.judge import FIELDS, METRICS, PROTOCOLS, EvalConfig, evaluate, find_pairs
from ..plots.table import text_table
from . import options

# Centres further apart than this, in longest sides of the target, are no error of a prediction.
_FAR = 0.25
# Shown x1000 in the table: squared distances of shapes of size 1 are small.
_SQUARED = ("forward", "backward", "chamfer")


@click.command("eval")
@click.argument("prediction", type=options.FilePath())
@click.argument("target", type=options.FilePath())
@click.option("--chamfer", is_flag=True, help="Chamfer distance (the default).")
@click.option("--f-score", is_flag=True, help="F-score at a distance.")
@click.option("--emd", is_flag=True, help="Earth mover's distance; clouds of equal size.")
@click.option("--iou", is_flag=True, help="IoU of silhouette and mask; needs --mask.")
@click.option("--protocol", type=click.Choice(PROTOCOLS), default="plain", show_default=True)
@click.option(
    "--points", type=int, metavar="N", help="Thin every cloud to N points first, farthest-point.  [default: all; capnet: 1024]"
)
@click.option("--samples", type=int, default=16384, show_default=True, help="Points drawn from a mesh or voxel grid.")
@click.option("--vertices", is_flag=True, help="Of meshes take the vertices, not the surface.")
@click.option("--threshold", type=float, help="Distance of the F-score.  [default: 1 % of the target's longest side]")
@click.option("--mask", type=options.FilePath(), help="Mask of the object, or a folder of NAME.png.")
@click.option(
    "--camera", type=options.FilePath(), help="Camera file, for one mask or for all, or a folder of NAME.camera.json."
)
@click.option("--sigma-sq", type=float, help="Of the IoU: the paper's silhouette, Gaussians of this variance, px^2.")
@click.option("--suffix", default="", help="In folders: predictions are the files NAME + this, such as .refined.")
@click.option("--fail-above", type=float, metavar="X", help="Exit with 3 if the mean Chamfer x1000 is above X.")
@options.seed
@options.as_json
def command(
    prediction: Path,
    target: Path,
    chamfer: bool,
    f_score: bool,
    emd: bool,
    iou: bool,
    protocol: str,
    points: int | None,
    samples: int,
    vertices: bool,
    threshold: float | None,
    mask: Path | None,
    camera: Path | None,
    sigma_sq: float | None,
    suffix: str,
    fail_above: float | None,
    seed: int,
    as_json: bool,
) -> None:
    """Judge PREDICTION against TARGET: two files, or two folders matched by name.

    Files are point clouds (.ply .npy .xyz .txt), meshes (.obj .off .stl .glb, .ply with faces) or voxel grids (.npy .binvox);
    meshes and grids are judged by points drawn from their surface, those of PREDICTION and TARGET each for itself: equal
    surfaces are as far apart as two samples. A .binvox grid is centred at the origin. In folders .txt files are left out.

    Chamfer: squared distances, mean over points; forward is target -> prediction, backward prediction -> target. The table
    shows it x1000, --json raw. --protocol capnet, the paper's, first thins each cloud to 1,024 points, then centres it on its
    own bounding box and scales it to longest side 1, which hides errors of scale and place.
    """
    asked = zip(METRICS, (chamfer, f_score, emd, iou), strict=True)
    chosen = tuple(name for name, wanted in asked if wanted) or ("chamfer",)
    config = EvalConfig(chosen, protocol, points, samples, threshold, sigma_sq, seed, vertices)
    if fail_above is not None and ("chamfer" not in chosen or not fail_above >= 0.0):
        raise InputError(f"--fail-above {fail_above:g} bounds the Chamfer distance, expected a number >= 0 and --chamfer")
    if "iou" in chosen and mask is None and camera is None:
        raise InputError("--iou needs --mask (with --camera, or a camera file beside it), or a --camera file that names masks")
    if "iou" not in chosen and (mask is not None or camera is not None):
        raise InputError("--mask and --camera serve --iou, which was not asked for")
    if "iou" not in chosen and sigma_sq is not None:
        raise InputError("--sigma-sq serves --iou, which was not asked for")
    if "f_score" not in chosen and threshold is not None:
        raise InputError("--threshold serves --f-score, which was not asked for")
    pairs = find_pairs(prediction, target, mask, camera, suffix)
    result = evaluate(pairs, config, options.ProgressBar("judging") if len(pairs) > 1 else None)
    _remarks(result["pairs"], config)
    if as_json:
        options.echo_json(result)
    else:
        click.echo(_table(result, config))
    if fail_above is not None and not 1000.0 * result["mean"]["chamfer"] <= fail_above:
        raise GateError(f"mean Chamfer x1000 is {1000.0 * result['mean']['chamfer']:.4g}, above {fail_above:g} (--fail-above)")


def _remarks(records: list[dict[str, Any]], config: EvalConfig) -> None:
    """What a reader of the numbers might not expect, on stderr."""
    for side in ("prediction", "target"):
        kinds = Counter(record[f"{side}_kind"] for record in records)
        read_as = {"mesh": "their vertices" if config.as_vertices else f"{config.samples:,} points of the surface"}
        read_as["voxels"] = f"{config.samples:,} points of the surface"
        for kind, how in read_as.items():
            if kinds[kind]:
                noun = {"mesh": "meshes", "voxels": "voxel grids"}[kind]
                hint = " (--vertices takes the vertices)" if kind == "mesh" and not config.as_vertices else ""
                options.log(f"{side}: {kinds[kind]} of {len(records)} are {noun}, judged by {how}{hint}")
    sides = [record["target_longest_side"] for record in records]
    if config.protocol != "plain":
        return
    far = [
        record
        for record, side in zip(records, sides, strict=True)
        if "voxels" in (record["prediction_kind"], record["target_kind"]) and record["centre_offset"] > _FAR * side
    ]
    if far:
        pairs = f", too far in {len(far)} of {len(records)} pairs" if len(far) > 1 else ""
        options.log(
            f"{far[0]['name']}: the centres of prediction and target are {far[0]['centre_offset']:.3g} apart{pairs}; voxel "
            "grids are centred at the origin, expected the same of what they are compared with (--protocol capnet centres both)"
        )
    if min(sides) > 0.0 and not all(0.98 < side < 1.02 for side in sides):
        span = f"{min(sides):.4g}" if len(sides) == 1 else f"{min(sides):.4g} to {max(sides):.4g}"
        options.log(f"the longest side of the target is {span}; published figures are for 1 (--protocol capnet rescales)")


def _table(result: dict[str, Any], config: EvalConfig) -> str:
    fields = [field for name in config.metrics for field in FIELDS[name]]
    factors = {field: 1000.0 if _thousandfold(field, config) else 1.0 for field in fields}
    titles = [field.replace("f_score", "F-score").replace("emd", "EMD").replace("iou", "IoU") for field in fields]
    header = ["name", "N prediction", "N target", *titles]
    rows: list[list[Any]] = [
        [record["name"], record["prediction_points"], record["target_points"], *(factors[f] * record[f] for f in fields)]
        for record in result["pairs"]
    ]
    several = len(rows) > 1
    if several:
        rows.append([f"mean of {len(rows)}", None, None, *(factors[f] * result["mean"][f] for f in fields)])
    return text_table(header, rows, rule_before_last=several) + "\n" + _footnote(result, config, fields)


def _thousandfold(field: str, config: EvalConfig) -> bool:
    return field in _SQUARED or (field == "emd" and config.protocol == "capnet")


def _footnote(result: dict[str, Any], config: EvalConfig, fields: list[str]) -> str:
    """The convention of every number above it."""
    convention = result["convention"]
    drawn = {"voxels"} if config.as_vertices else {"mesh", "voxels"}
    lines = []
    if "chamfer" in fields:
        lines.append(f"Chamfer x1000: {convention['chamfer']}")
    if "f_score" in fields:
        lines.append(f"F-score: {convention['f_score']}")
    if "emd" in fields:
        lines.append(f"EMD{' x1000' if _thousandfold('emd', config) else ''}: {convention['emd']}")
    if "iou" in fields:
        lines.append(f"IoU: {convention['iou']}; clouds in their own frame")
    if any({record["prediction_kind"], record["target_kind"]} <= drawn for record in result["pairs"]):
        lines.append(
            "surfaces: prediction and target draw their own points, so that equal shapes are not at 0 but at two samples"
        )
    lines.append(
        f"protocol {config.protocol} (normalisation: {convention['normalisation']}), {convention['thinning']}, "
        f"samples {config.samples}, seed {config.seed}, cpu, float64"
    )
    return "\n".join(lines)
