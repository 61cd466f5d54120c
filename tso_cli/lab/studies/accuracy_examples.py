"""Cases of a finished study of accuracy that are worth looking at."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ..charts.accuracy_pictures import Pictured
from .accuracy import AccuracyConfig, builder_of
from .accuracy_summary import chosen, ratios_of
from .accuracy_variants import DEFAULT, alone, variants_of
from .parts import shapes_of_part


def telling_cases(
    record: dict[str, Any], folder: Path, config: AccuracyConfig, split_file: Path, checkpoint: Path | None
) -> list[Pictured]:
    """The worst, the median and the best case of each category under the default preset, made and refined once more.

    Of the first kind in ``record``, which is of the settings that the other arguments say.
    """
    builder, network, _ = builder_of(folder, config, split_file, checkpoint)
    shapes = {shape.name: shape for shape in shapes_of_part(folder, split_file, config.part, config.categories, config.limit)}
    kind = next(iter(record["summary"]))
    found = []
    for category in record["summary"][kind]:
        cases = chosen(record["cases"], kind, category)
        ratios = ratios_of(cases, DEFAULT)
        order = np.argsort(ratios)[::-1]
        # Of one or two cases there are no three to show.
        places = {order[0]: "worst", order[len(order) // 2]: "median", order[-1]: "best"}
        for place, name in places.items():
            known = cases[place]
            case = builder.cases(shapes[known["shape"]], kind)[known["view"]]
            result, _ = alone(case, variants_of(kind, config.ablation)[DEFAULT], config.device, network)
            title = f"{category}\n{name}: {ratios[place]:.2f}\n{known['shape'].partition('/')[2][:16]}"
            found.append(Pictured(title, case.views[0], case.initial, result.points, case.target))
    return found
