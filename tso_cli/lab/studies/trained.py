"""Studies that train a network for each of their settings, under one budget, and judge all on unseen shapes."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from ... import device as devices
from ...errors import InputError
from ...network.model import NetworkConfig, build_network
from ...train import TrainConfig, TrainResult, network_config, start, train
from ...train.data import TrainingData
from ...train.state import TrainingState, load_training, save_training, state_path
from ..study import DEVICE, MESHES, SEED, SPLIT, Option, Progress, Record, Study, Table, part, record_of
from .discretised import DEPTH, GAUSSIAN, projected_objective
from .judging import CONVENTION, JUDGED_VIEWS, Predicted, judge, predict
from .material import ALL, TEST_VIEWS, TRAINING_VIEWS, Material, Source
from .mean_shape import constant_answer
from .parts import SPLIT as SHIPPED_SPLIT

CATEGORIES = ("airplane", "car", "chair")
OPTIONS = (
    MESHES,
    SPLIT,
    part("test"),
    Option("--category", "May be repeated.  [default: see above]", multiple=True, default=(), name="categories"),
    Option("--full", "20,000 steps of 16 on all shapes at the paper's rate, 5e-5, weights not averaged.", bool),
    Option("--steps", "Of every network.  [default: reduced, see above]", int, least=1),
    Option("--batch-size", "[default: 8; 16 with --full]", int, least=1),
    Option("--limit", "Training shapes a category.  [default: 32; all with --full]", int, least=1),
    Option("--frame", "Axes of the predicted points: the objects' or the camera's.", str, "canonical", ("canonical", "view")),
    SEED,
    DEVICE,
)
SAVE_EVERY = 500
# The same training comes out as far away another time: a smaller difference is noise.
NOISE = 0.95
# The paper's rate gets nowhere in few steps.
REDUCED = {"batch_size": 8, "learning_rate": 3e-4, "averaging": 0.99}
FULL = {"steps": 20_000, "batch_size": 16, "learning_rate": 5e-5, "averaging": 0.0}


@dataclass(frozen=True)
class Setting:
    """One network of a study.

    name : in tables; unique among the settings of a category.
    category : to train and judge on; `ALL` for all categories of the study, each equally often.
    changes : fields of `train.TrainConfig` in which it differs from the others.
    projection : "gaussian" (the paper's), or one of `discretised.PROJECTIONS`.
    constant : judge the mean training shape instead of a network. repeat : is added to the seed.
    latent_relu : put a ReLU behind the latent vector. bounded : points beyond the crop count as outliers.
    whole : uncropped pictures, which show size, and clouds in the scale of ShapeNet.
    """

    name: str
    category: str
    changes: dict[str, Any] = field(default_factory=dict)
    projection: str = GAUSSIAN
    constant: bool = False
    repeat: int = 0
    latent_relu: bool = False
    bounded: bool = True
    whole: bool = False


@dataclass(frozen=True)
class Comparison:
    """What a study compares.

    steps, reduced : of the reduced size: steps of a network, categories. full : categories of the full size.
    settings : categories -> the networks to train.
    conclude : runs -> what else the record says: "summary", "paper", "claims".
    measure : predictions of a network, judged data -> what else its run says.
    """

    name: str
    steps: int
    reduced: tuple[str, ...]
    settings: Callable[[Sequence[str]], list[Setting]]
    conclude: Callable[[list[Record]], Record]
    measure: Callable[[list[Predicted], TrainingData], Record] = lambda predicted, data: {}
    full: tuple[str, ...] = CATEGORIES

    def study(
        self,
        about: str,
        tables: Callable[[Record], list[Table]],
        draw: Callable[[Path, Record, bool], None],
        reading: str,
    ) -> Study:
        """The study that makes this comparison."""
        return Study(self.name, about, OPTIONS, self.run, tables, draw, reading, "after every network and every 500 steps")

    def run(self, progress: Progress, *, categories: tuple[str, ...], full: bool, **options: Any) -> Record:
        """Train and judge the network of each setting that the earlier record lacks; the parameters are `OPTIONS`.

        The record's runs: [{"setting", "category", ..., "judged": {category: {"shapes", "capnet", "plain"}}}], raw distances.

        Raises InputError if a shape is missing or the earlier record is of other settings; KeyboardInterrupt by Ctrl-C: the
        state of the network is kept.
        """
        categories = categories or (self.full if full else self.reduced)
        limit = options["limit"] or (None if full else 32)
        split = options["split"] or SHIPPED_SPLIT
        settings = self.settings(categories)
        source = Source(options["meshes"], split, options["part"], categories, limit, options["seed"])
        material = Material(source, progress.report)
        budget = {"steps": self.steps, **(FULL if full else REDUCED)}
        budget |= {key: options[key] for key in ("steps", "batch_size", "frame", "seed", "device") if options[key] is not None}
        common = {
            **budget,
            "split": split.name,
            "part": options["part"],
            "shapes": material.counts(),
            "names": material.fingerprint(),
            "training_views": TRAINING_VIEWS,
            "judged_views": JUDGED_VIEWS,
            "rendered_views": TEST_VIEWS,
            "networks": [[setting.name, setting.category] for setting in settings],
        }
        earlier = progress.earlier and {**progress.earlier, "cases": progress.earlier.get("runs")}
        runs = replace(progress, earlier=earlier).earlier_cases(self.name, common)
        convention = {**CONVENTION, "frame": f"predictions in the {budget['frame']} frame"}
        if progress.earlier is None:
            _forget(progress.unfinished)

        def keep_record() -> Record:
            complete = len(runs) == len(settings)
            record = record_of(self.name, convention, complete=complete, settings=common, runs=list(runs))
            record |= self.conclude(runs) if complete else {}
            progress.keep(record)
            return record

        # Even without a run: the state of the first network is of the method that the record says.
        record = keep_record()
        for number, setting in enumerate(settings[len(runs) :], len(runs) + 1):
            doing = f"{number} of {len(settings)}: {setting.name}, {setting.category}"
            runs.append(self._run(material, setting, budget, progress, doing))
            record = keep_record()
            _forget(progress.unfinished)
        return record

    def _run(self, material: Material, setting: Setting, budget: Record, progress: Progress, doing: str) -> Record:
        """The run of one setting."""
        run: Record = {"setting": setting.name, "category": setting.category}
        data = material.data(setting.category, True, dense=setting.projection == DEPTH, whole=setting.whole)
        unseen = material.data(setting.category, False, whole=setting.whole)
        if setting.constant:
            return {**run, "judged": judge(constant_answer(data, unseen, budget["frame"]))}
        common = {**budget, "seed": budget["seed"] + setting.repeat, "balance": setting.category == ALL}
        config = TrainConfig(**{**common, **setting.changes})
        begun = time.perf_counter()
        result = _train(data, config, setting, progress, doing)
        seconds = time.perf_counter() - begun
        predicted = predict(result.network, unseen, config.frame)
        used = asdict(config) | {"projection": setting.projection, "lambda": config.affinity_weight}
        of_masks = ("projection", "views", "sigma_sq", "category_sigma_sq", "lambda", "affinity")
        run |= {key: used[key] for key in ("supervision", "steps", "batch_size", "seed", "device")}
        run |= {key: used[key] if config.supervision == "masks" else None for key in of_masks}
        run |= {"lambda_dropped_at": result.lambda_dropped_at, "seconds": seconds, "judged": judge(predicted)}
        return run | self.measure(predicted, unseen)


def _train(data: TrainingData, config: TrainConfig, setting: Setting, progress: Progress, doing: str) -> TrainResult:
    """Train one network, from its unfinished state where there is one."""
    objective, unfinished, state = None, progress.unfinished, None
    if setting.projection != GAUSSIAN or not setting.bounded:
        objective = projected_objective(config, setting.projection, setting.bounded)
    if setting.latent_relu:
        network = build_network(config.points, config.seed)
        network.encoder = torch.nn.Sequential(network.encoder, torch.nn.ReLU())  # type: ignore[assignment]
        state = start(data, config, network)
    elif unfinished:
        # A state that is missing, damaged or of another network of the study: this one starts anew.
        with suppress(InputError):
            expected = network_config(data, config, 0)
            state = load_training(unfinished, expected, data.fingerprint(), devices.resolve(config.device))

    def save(current: TrainingState, described: NetworkConfig) -> None:
        if unfinished and current.step < config.steps:
            save_training(unfinished, current, described)

    result = train(
        data,
        config,
        state,
        objective=objective,
        progress=lambda done, total, note: progress.report(doing, done, total),
        save=save,
        save_every=SAVE_EVERY,
    )
    if result.stop_reason == "interrupted":
        raise KeyboardInterrupt
    return result


def _forget(unfinished: Path | None) -> None:
    """Remove the state of an unfinished network."""
    if unfinished:
        unfinished.unlink(missing_ok=True)
        state_path(unfinished).unlink(missing_ok=True)


def masks(category: str, **changes: Any) -> dict[str, Any]:
    """Supervision with masks, under the paper's sigma^2 of a network for one category."""
    return {"supervision": "masks", "sigma_sq": 0.1 if category == "airplane" else 0.4, **changes}


def repeated(name: str, repeat: int) -> str:
    """The name of a setting of which several networks differ in their seed alone."""
    return f"{name}, seed + {repeat}" if repeat else name


def chamfers(runs: Sequence[Record]) -> dict[str, dict[str, float]]:
    """Chamfer distance x1000 under the paper's protocol: {setting: {category: value}}."""
    values: dict[str, dict[str, float]] = {}
    for category in dict.fromkeys(category for run in runs for category in run["judged"]):
        for run in runs:
            if category in run["judged"]:
                distance = run["judged"][category]["capnet"]["chamfer"]
                values.setdefault(run["setting"], {})[category] = float(1e3 * distance)
    return values


def with_mean(values: dict[str, float]) -> dict[str, float]:
    """The mean over categories, then the ``values`` of each."""
    return {"mean": float(np.mean(list(values.values()))), **values}


def table(record: Record, corner: str, rows: dict[str, dict[str, Any]], note: str = "") -> Table:
    """A row for each of ``rows``, a column for each of their keys, headed ``corner``; below it the budget of the record."""
    settings = record["settings"]
    shapes = ", ".join(f"{name} {n['training']} to train and {n['judged']} to judge" for name, n in settings["shapes"].items())
    budget = (
        f"{settings['steps']} steps of {settings['batch_size']} at a rate of {settings['learning_rate']:g}, seed "
        f"{settings['seed']}, {settings['frame']} frame, {settings['device']}; shapes: {shapes} ({settings['part']}), "
        f"{settings['judged_views']} views each. Chamfer x1000 under the paper's protocol, capnet."
    )
    columns = list(dict.fromkeys(key for values in rows.values() for key in values))
    cells = [[name, *map(values.get, columns)] for name, values in rows.items()]
    return Table([corner, *columns], cells, note="\n".join(filter(None, (note, budget))), decimals=2)
