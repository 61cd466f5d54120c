"""Studies that train a network for each of their settings: the settings, the budget they share, and the record."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from ...errors import InputError
from ...io.reading import shown
from ...network.model import BaseNetwork, NetworkConfig, build_network
from ...train import TrainConfig, network_config, start, train
from ...train.batches import Batch
from ...train.data import TrainingData
from ...train.losses import mask_loss
from ...train.state import TrainingState, load_training, save_training, state_path
from ...train.step import Objective
from ...version import __version__
from .judging import CONVENTION, JUDGED_VIEWS, Predicted, judge, predict
from .material import ALL, TEST_VIEWS, TRAINING_VIEWS, Material, Source
from .mean_shape import constant_answer
from .other_projections import DEPTH, GAUSSIAN, first_gradients, projected_objective
from .protocol import Report

Record = dict[str, Any]
Measure = Callable[[list[Predicted], TrainingData], Record]
# Steps between the states of an unfinished network.
SAVE_EVERY = 500


@dataclass(frozen=True)
class Budget:
    """What every setting of a study may spend; the defaults are the reduced size, except for the steps.

    Parameters
    ----------
    steps, batch_size, learning_rate, averaging : see `train.TrainConfig`. The rate is higher than the paper's, which gets
        nowhere in few steps.
    seed : of weights, pictures and draws. frame : of the predicted points; the paper's for 2D supervision is the objects' own.
    """

    steps: int
    batch_size: int = 8
    learning_rate: float = 3e-4
    averaging: float = 0.99
    frame: str = "canonical"
    seed: int = 0
    device: str = "cpu"

    @classmethod
    def full(cls, **changes: Any) -> Budget:
        """The paper's rate, over as many steps as it takes."""
        return cls(**{"steps": 20_000, "batch_size": 16, "learning_rate": 5e-5, "averaging": 0.0, **changes})

    def config(self, **changes: Any) -> TrainConfig:
        """Settings of one network."""
        return TrainConfig(**{**asdict(self), **changes})


@dataclass(frozen=True)
class Setting:
    """One network of a study.

    Parameters
    ----------
    name : what tables call it.
    category : what it is trained and judged on; `ALL` for the categories of the study at once, each equally often.
    changes : its own settings of `train.TrainConfig`.
    constant : no network: the mean training shape, whatever the picture shows.
    repeat : which of several networks that differ in their seed alone.
    projection : "gaussian" (the paper's), or one of `other_projections.PROJECTIONS`.
    latent_relu : a ReLU behind the latent vector. bounded : points beyond the crop count as outliers.
    whole : pictures that show size, and clouds in the scale of ShapeNet.
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


@dataclass(frozen=True, eq=False)
class Keeping:
    """What an interrupted study leaves behind.

    Parameters
    ----------
    earlier : a record of the same settings, complete or not; the networks in it are not trained again.
    keep : called after every network with the record so far, whose ``complete`` is False until the last.
    unfinished : checkpoint beside which the state of the network at hand is kept, to go on within it; None keeps none.
    """

    earlier: Record | None = None
    keep: Callable[[Record], None] | None = None
    unfinished: Path | None = None


def study_networks(
    name: str,
    source: Source,
    budget: Budget,
    settings: list[Setting],
    conclude: Callable[[list[Record]], Record],
    measure: Measure | None = None,
    keeping: Keeping | None = None,
    report: Report | None = None,
) -> Record:
    """Train a network for each setting, judge it on unseen shapes, keep the record.

    Parameters
    ----------
    conclude : from the runs of all settings, what else the record says: "paper", "summary", "claims".
    measure : from the predictions of a network and the judged data, what else its run says.
    report : called with (what, done, total).

    Returns
    -------
    A JSON-able record: {"study", "complete", "settings", "convention", "runs": [{"setting", "category", ..., "judged":
    {category: {"shapes", "capnet", "plain"}}}]} and what ``conclude`` adds. Distances are raw.

    Raises
    ------
    InputError
        A shape is missing, or the earlier record is of other settings.
    KeyboardInterrupt
        Ctrl-C: the step at hand was finished, and what there is was kept.
    """
    keeping = keeping or Keeping()
    material = Material(source, report)
    common = {
        **asdict(budget),
        "split": source.split.name,
        "part": source.part,
        "shapes": material.counts(),
        "names": material.fingerprint(),
        "training_views": TRAINING_VIEWS,
        "judged_views": JUDGED_VIEWS,
        "rendered_views": TEST_VIEWS,
        "networks": [[setting.name, setting.category] for setting in settings],
    }
    runs = _earlier_runs(keeping.earlier, name, common)
    if keeping.keep and keeping.earlier is None:
        # What is gone on with, the first network's state too, is of the method that this record says.
        keeping.keep(_record(name, common, runs, False))
    done = {(run["setting"], run["category"]) for run in runs}
    for number, setting in enumerate(settings, 1):
        if (setting.name, setting.category) in done:
            continue
        told = f"{number} of {len(settings)}: {setting.name}, {setting.category}"
        runs.append(_run(material, budget, setting, measure, keeping.unfinished, report, told))
        record = _record(name, common, runs, False)
        if keeping.keep and number < len(settings):
            keeping.keep(record)
            forget(keeping.unfinished)
    # Settings may have been added to a record out of order: tables follow the order of the study.
    order = [(setting.name, setting.category) for setting in settings]
    runs.sort(key=lambda run: order.index((run["setting"], run["category"])))
    record = {**_record(name, common, runs, True), **conclude(runs)}
    if keeping.keep:
        keeping.keep(record)
        forget(keeping.unfinished)
    return record


def _run(
    material: Material,
    budget: Budget,
    setting: Setting,
    measure: Measure | None,
    unfinished: Path | None,
    report: Report | None,
    told: str,
) -> Record:
    """Train and judge one network, or judge the constant answer."""
    if setting.constant:
        answer = constant_answer(material.data(setting.category, True), material.data(setting.category, False), budget.frame)
        return {"setting": setting.name, "category": setting.category, "judged": judge(answer)}
    seed = budget.seed + setting.repeat
    config = budget.config(**{"seed": seed, "balance": setting.category == ALL, **setting.changes})
    data = material.data(setting.category, True, dense=setting.projection == DEPTH, whole=setting.whole)

    def progress(done: int, total: int, note: str) -> None:
        if report:
            report(told, done, total)

    extra: Record = {}
    start = time.perf_counter()
    objective = None
    if setting.projection != GAUSSIAN:
        objective = projected_objective(config, setting.projection)
        extra["bce_gradient"] = first_gradients(data, config)
    elif not setting.bounded:
        objective = partial(_unbounded, config)
    network, dropped = _trained(data, config, unfinished, progress, objective, setting.latent_relu)
    seconds = time.perf_counter() - start
    unseen = material.data(setting.category, False, whole=setting.whole)
    predicted = predict(network, unseen, config.frame)
    masks = config.supervision == "masks"
    return {
        "setting": setting.name,
        "category": setting.category,
        "supervision": config.supervision,
        "projection": setting.projection if masks else None,
        "views": config.views if masks else None,
        "sigma_sq": config.sigma_sq if masks else None,
        "category_sigma_sq": dict(config.category_sigma_sq) if masks else None,
        "lambda": config.affinity_weight if masks else None,
        "affinity": config.affinity if masks else None,
        "lambda_dropped_at": dropped,
        "steps": config.steps,
        "batch_size": config.batch_size,
        "seed": config.seed,
        "seconds": seconds,
        "device": config.device,
        "judged": judge(predicted),
        **extra,
        **(measure(predicted, unseen) if measure else {}),
    }


def _trained(
    data: TrainingData,
    config: TrainConfig,
    unfinished: Path | None,
    progress: Callable[[int, int, str], None],
    objective: Objective | None,
    latent_relu: bool,
) -> tuple[BaseNetwork, int | None]:
    """The trained network, gone on with where its state lies beside ``unfinished``; and when lambda dropped."""
    state: TrainingState | None = None
    if unfinished is not None and state_path(unfinished).exists():
        try:
            from ... import device as devices

            described = network_config(data, config, 0)
            state = load_training(unfinished, described, data.fingerprint(), devices.resolve(config.device))
        except InputError:
            state = None  # of another network of the study, or damaged: this one starts anew
    if latent_relu:
        network = build_network(config.points, config.seed)
        network.encoder = torch.nn.Sequential(network.encoder, torch.nn.ReLU())  # type: ignore[assignment]
        state = start(data, config, network)

    def save(current: TrainingState, described: NetworkConfig) -> None:
        # A finished network goes into the record; only what is to be gone on with needs its state.
        if unfinished is not None and current.step < config.steps:
            save_training(unfinished, current, described)

    result = train(data, config, state, objective=objective, progress=progress, save=save, save_every=SAVE_EVERY)
    if result.stop_reason == "interrupted":
        raise KeyboardInterrupt
    return result.network, result.lambda_dropped_at


def _unbounded(config: TrainConfig, points: Tensor, batch: Batch, weight: float) -> tuple[Tensor, float, float]:
    return mask_loss(points, batch, config.sigma_sq, weight, config.affinity, bounded=False)


def forget(unfinished: Path | None) -> None:
    """Remove the state of an unfinished network."""
    if unfinished is not None:
        for path in (unfinished, state_path(unfinished)):
            path.unlink(missing_ok=True)


def _earlier_runs(earlier: Record | None, name: str, common: Record) -> list[Record]:
    """The runs of a record to go on from; InputError where it is of another study, or of other settings."""
    if earlier is None:
        return []
    if earlier.get("study") != name or not isinstance(earlier.get("runs"), list):
        raise InputError(f"the record to go on from is of the study {shown(earlier.get('study'))}, expected {name!r}")
    before = earlier.get("settings")
    before = before if isinstance(before, dict) else {}
    for key, value in common.items():
        if before.get(key) != value:
            raise InputError(
                f"the record to go on from was made with {key} {shown(before.get(key))}, now it is {shown(value)}; "
                "expected the same settings"
            )
    return list(earlier["runs"])


def _record(name: str, common: Record, runs: list[Record], complete: bool) -> Record:
    return {
        "study": name,
        "version": __version__,
        "complete": complete,
        "settings": common,
        "convention": {**CONVENTION, "frame": f"predictions in the {common['frame']} frame"},
        "runs": list(runs),
    }
