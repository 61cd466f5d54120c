"""`tso eval`: compare clouds with ground truth."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from ..errors import GateError, InputError
from ..evaluation.config import FIELDS, METRICS, EvalConfig
from ..option import opt
from ..plots.table import text_table
from . import options


@dataclass(frozen=True, kw_only=True)
class EvalOptions(EvalConfig):
    """What `tso eval` may be given; InputError for options that do not go together.

    mask : Mask of the object, or a folder with NAME.png.
    camera : Camera file for all masks, or a folder with NAME.camera.json.
    suffix : In folders: what the predictions' names have after NAME, such as .refined.
    fail_above : Exit with code 3 if the mean Chamfer distance x1000 is above X.
    """

    prediction: Path = opt(options.REQUIRED, role="argument")
    target: Path = opt(options.REQUIRED, role="argument")
    mask: Path | None = opt(None, heading="Masks", needs=("iou",))
    camera: Path | None = opt(None, "the camera file next to the mask", needs=("iou",))
    label: str | None = options.label()
    mask_index: int | None = options.mask_index()
    suffix: str = opt("", heading="Input and output")
    fail_above: float | None = opt(None, least=0.0)
    as_json: bool = options.as_json()

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.fail_above is not None and "chamfer" not in self.metrics:
            raise InputError("--fail-above bounds the Chamfer distance, expected --chamfer too")
        if self.iou and self.mask is None and self.camera is None:
            raise InputError(
                "--iou needs --mask (with --camera, or a camera file next to the mask), "
                "or a --camera file that names masks"
            )
        if not self.iou and (self.label, self.mask_index) != (None, None):
            raise InputError("--label and --mask-index say nothing without --iou, expected --iou")


@options.command("eval", EvalOptions)
def command(ctx: click.Context, chosen: EvalOptions) -> None:
    """Compare PREDICTION with TARGET: two files, or two folders matched by name.

    Files are point clouds (.ply .npy .xyz .txt), meshes (.obj .off .stl .glb, .ply with faces) or
    voxel grids (.npy .binvox). Meshes and grids are compared by points sampled from their surfaces.
    PREDICTION and TARGET are sampled independently, so the distance of two equal surfaces is not 0.
    A .binvox grid is centred at the origin. In folders, .txt files are ignored.

    The Chamfer distance is the mean of squared distances over the points. Forward is from target to
    prediction, backward from prediction to target, Chamfer their sum. The table shows it x1000,
    --json shows it as it is.

    --protocol capnet is the paper's: it thins each cloud to 1,024 points, centres it on its own
    bounding box and scales it to longest side 1. This hides errors of scale and position.
    """
    from ..evaluation.compare import evaluate
    from ..evaluation.pairs import find_pairs

    pairs = find_pairs(chosen.prediction, chosen.target, chosen.mask, chosen.camera, chosen.suffix)
    bar = options.ProgressBar("evaluating") if len(pairs) > 1 else None
    result = evaluate(pairs, chosen, bar)
    _log_remarks(result["pairs"], chosen)
    if chosen.as_json:
        options.echo_json(result)
    else:
        click.echo(_table(result, chosen))
    limit, mean = chosen.fail_above, 1000.0 * result["mean"].get("chamfer", 0.0)
    if limit is not None and not mean <= limit:
        raise GateError(f"mean Chamfer x1000 is {mean:.4g}, above {limit:g} (--fail-above)")


def _log_remarks(records: list[dict[str, Any]], config: EvalConfig) -> None:
    """Log what may surprise a reader of the numbers.

    1. Meshes and voxel grids are compared by samples.
    2. A voxel grid and a shape seem to be in different frames, because their centres are more than
       a quarter of the target's longest side apart.
    3. The target does not have longest side 1, as published shapes have within 2 %.
    """
    samples = f"{config.samples:,} points of the surface"
    meshes = (
        "their vertices" if config.as_vertices else f"{samples} (--vertices takes the vertices)"
    )
    for side in ("prediction", "target"):
        kinds = Counter(record[f"{side}_kind"] for record in records)
        for kind, noun, how in (("mesh", "meshes", meshes), ("voxels", "voxel grids", samples)):
            if kinds[kind]:
                options.log(
                    f"{side}: {kinds[kind]} of {len(records)} are {noun}, compared by {how}"
                )
    if config.protocol != "plain":
        return
    far = [
        record
        for record in records
        if "voxels" in (record["prediction_kind"], record["target_kind"])
        and record["centre_offset"] > 0.25 * record["target_longest_side"]
    ]
    if far:
        pairs = f", too far in {len(far)} of {len(records)} pairs" if len(far) > 1 else ""
        options.log(
            f"{far[0]['name']}: the centres of prediction and target are "
            f"{far[0]['centre_offset']:.3g} apart{pairs}; voxel grids are centred at the origin, "
            "expected the other shape centred there too (--protocol capnet centres both)"
        )
    sides = [record["target_longest_side"] for record in records]
    if min(sides) > 0.0 and not all(abs(side - 1.0) < 0.02 for side in sides):
        span = f"{min(sides):.4g}" if len(sides) == 1 else f"{min(sides):.4g} to {max(sides):.4g}"
        options.log(
            f"the longest side of the target is {span}; published figures are for 1 "
            "(--protocol capnet rescales)"
        )


def _table(result: dict[str, Any], config: EvalConfig) -> str:
    fields = [field for name in config.metrics for field in FIELDS[name]]
    # Squared distances of shapes of size 1 are small: show them x1000.
    squared = {*FIELDS["chamfer"], *(["emd"] if config.protocol == "capnet" else [])}

    def cells(values: dict[str, float]) -> list[float]:
        return [(1000.0 if field in squared else 1.0) * values[field] for field in fields]

    titles = [
        field.replace("f_score", "F-score").replace("emd", "EMD").replace("iou", "IoU")
        for field in fields
    ]
    rows: list[list[Any]] = [
        [record["name"], record["prediction_points"], record["target_points"], *cells(record)]
        for record in result["pairs"]
    ]
    has_mean = len(rows) > 1
    if has_mean:
        rows.append([f"mean of {len(rows)}", None, None, *cells(result["mean"])])
    header = ["name", "N prediction", "N target", *titles]
    table = text_table(header, rows, rule_before_last=has_mean)
    return "\n".join([table, *_conventions(result, config, "emd" in squared)])


def _conventions(result: dict[str, Any], config: EvalConfig, squared_emd: bool) -> list[str]:
    """Lines that state the convention of every number."""
    convention = result["convention"]
    sampled = {"voxels"} if config.as_vertices else {"mesh", "voxels"}
    labels = {
        "chamfer": "Chamfer x1000",
        "f_score": "F-score",
        "emd": f"EMD{' x1000' if squared_emd else ''}",
        "iou": "IoU",
    }
    lines = [f"{labels[name]}: {convention[name]}" for name in METRICS if name in config.metrics]
    if "iou" in config.metrics:
        lines[-1] += "; clouds in their own frame"
    kinds = [{record["prediction_kind"], record["target_kind"]} for record in result["pairs"]]
    if any(pair <= sampled for pair in kinds):
        lines.append(
            "surfaces: prediction and target draw their own points, "
            "so that the distance of equal shapes is not 0"
        )
    lines.append(
        f"protocol {config.protocol} (normalisation: {convention['normalisation']}), "
        f"{convention['thinning']}, samples {config.samples}, seed {config.seed}, cpu, float64"
    )
    return lines
