"""Studies that train a network for each of their settings, under one budget, and judge all on unseen shapes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ...train import TrainConfig, train
from ...train.data import TrainingData
from ..charts import Rows, draw_bars
from ..study import (
    DEVICE,
    MESHES,
    SEED,
    SPLIT,
    Cases,
    Option,
    Plan,
    Progress,
    Record,
    Study,
    Table,
    part,
)
from .discretised import DEPTH, projected_objective
from .judging import (
    ALL,
    CONVENTION,
    FRAME,
    JUDGED_VIEWS,
    Material,
    Predicted,
    constant_answer,
    judge,
    predict,
)
from .shapes import SPLIT as SHIPPED_SPLIT

CATEGORIES = ("airplane", "car", "chair")
OPTIONS = (
    MESHES,
    SPLIT,
    part("test"),
    Option(
        "--category",
        "May be repeated.  [default: see above]",
        multiple=True,
        default=(),
        name="categories",
    ),
    Option("--steps", "Of every network.  [default: see above]", int, least=1),
    Option("--batch-size", kind=int, default=8, least=1),
    Option("--limit", "Training shapes a category.", int, 32, least=1),
    SEED,
    DEVICE,
)
# The same training comes out as far away another time: a smaller difference is noise.
NOISE = 0.95
# The paper's rate of 5e-5 gets nowhere in few steps.
RATE, AVERAGING = 3e-4, 0.99


@dataclass(frozen=True)
class Setting:
    """One network of a study.

    name : in tables; unique among the settings of a category. category : to train and judge on; `ALL` : all, equally often.
    changes : fields of `train.TrainConfig` in which it differs. projection : of `discretised`; empty for the paper's.
    constant : judge the mean training shape instead of a network. repeat : is added to the seed.
    """

    name: str
    category: str
    changes: dict[str, Any] = field(default_factory=dict)
    projection: str = ""
    constant: bool = False
    repeat: int = 0


@dataclass(frozen=True)
class Comparison:
    """The networks that a study compares.

    steps : of each network; categories : without ``--category``. settings : categories -> the networks to train.
    measure : predictions of a network, judged data -> what else its case says.
    """

    steps: int
    categories: tuple[str, ...]
    settings: Callable[[Sequence[str]], list[Setting]]
    measure: Callable[[list[Predicted], TrainingData], Record] = lambda predicted, data: {}

    def plan(
        self,
        progress: Progress,
        *,
        meshes: Path,
        split: Path | None,
        part: str,
        limit: int,
        **options: Any,
    ) -> Plan:
        """Train and judge the network of each setting; the parameters are `OPTIONS`.

        The cases: {"setting", "category", "judged": {category: Chamfer distance x1000}, ...}. Raises InputError if a shape is
        missing.
        """
        categories = options.pop("categories") or self.categories
        networks = self.settings(categories)
        material = Material(
            meshes, split, part, categories, limit, options["seed"], progress.report
        )
        budget = {
            **options,
            "steps": options["steps"] or self.steps,
            "learning_rate": RATE,
            "averaging": AVERAGING,
        }
        budget["frame"] = FRAME
        about = {"split": (split or SHIPPED_SPLIT).name, "part": part}
        jobs = []
        for number, network in enumerate(networks, 1):
            doing = f"{number} of {len(networks)}: {network.name}, {network.category}"
            shared = {"setting": network.name, "category": network.category}
            jobs.append((shared, partial(self._judge, material, network, budget, progress, doing)))
        settings = {**budget, **about, "shapes": material.counts(), "names": material.names_hash()}
        return Plan(settings, jobs, "training")

    def _judge(
        self, material: Material, setting: Setting, budget: Record, progress: Progress, doing: str
    ) -> Cases:
        case: Record = {"setting": setting.name, "category": setting.category}
        data = material.data(setting.category, True, dense=setting.projection == DEPTH)
        unseen = material.data(setting.category, False)
        if setting.constant:
            return [{**case, "judged": judge(constant_answer(data, unseen))}]
        common = {
            **budget,
            "seed": budget["seed"] + setting.repeat,
            "balance": setting.category == ALL,
        }
        config = TrainConfig(**{**common, **setting.changes})
        result = train(
            data,
            config,
            objective=projected_objective(config, setting.projection)
            if setting.projection
            else None,
            progress=lambda done, total, note: progress.report(doing, done, total),
        )
        if result.stop_reason == "interrupted":
            raise KeyboardInterrupt
        predicted = predict(result.network, unseen)
        return [{**case, "judged": judge(predicted), **self.measure(predicted, unseen)}]


def masks(category: str, **changes: Any) -> dict[str, Any]:
    """Supervision with masks, under the paper's sigma^2 of a network for one category."""
    return {"supervision": "masks", "sigma_sq": 0.1 if category == "airplane" else 0.4, **changes}


def chamfers(cases: Cases) -> dict[str, dict[str, float]]:
    """Chamfer distance x1000 under the paper's protocol: {setting: {category: value}}."""
    values: dict[str, dict[str, float]] = {}
    for category in dict.fromkeys(category for case in cases for category in case["judged"]):
        for case in cases:
            if category in case["judged"]:
                values.setdefault(case["setting"], {})[category] = case["judged"][category]
    return values


def with_mean(values: dict[str, float]) -> dict[str, float]:
    """The mean over categories, then the ``values`` of each."""
    return {"mean": float(np.mean(list(values.values()))), **values}


def trained_study(
    name: str,
    about: str,
    reading: str,
    comparison: Comparison,
    conclude: Callable[[Cases], Record],
    rows: Callable[[Record], Rows],
    notes: Record | None = None,
) -> Study:
    """The study that makes a comparison; ``rows`` : record -> title -> row -> column -> value, which tables and bars show."""

    def tables(record: Record) -> list[Table]:
        return [
            _table(record["settings"], title, of_title) for title, of_title in rows(record).items()
        ]

    return Study(
        name=name,
        about=about,
        parts=("pictures", "training"),
        tables=tables,
        draw=lambda path, record, overwrite: draw_bars(path, rows(record), overwrite),
        reading=reading,
        convention={**CONVENTION, **(notes or {})},
        options=OPTIONS,
        plan=comparison.plan,
        conclude=conclude,
    )


def _table(settings: Record, title: str, rows: Mapping[str, Mapping[str, float | None]]) -> Table:
    """A row for each of ``rows``, a column for each of their keys; below it the budget of the networks."""
    shapes = ", ".join(
        f"{name} {n['training']} to train and {n['judged']} to judge"
        for name, n in settings["shapes"].items()
    )
    budget = (
        f"{settings['steps']} steps of {settings['batch_size']} at a rate of {settings['learning_rate']:g}, seed "
        f"{settings['seed']}, {settings['frame']} frame, {settings['device']}; shapes: {shapes} ({settings['part']}), "
        f"{JUDGED_VIEWS} views each. Chamfer x1000 under the paper's protocol."
    )
    columns = list(dict.fromkeys(key for values in rows.values() for key in values))
    return Table(
        [title, *columns],
        [[name, *map(values.get, columns)] for name, values in rows.items()],
        note=budget,
        decimals=2,
    )
