"""What does a learned prior learn from, and for how long? Priors are trained and compared."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from tso_cli.datasets.splits import read_part
from tso_cli.io.meshes import read_mesh
from tso_cli.plots.style import COLOURS, page
from tso_cli.prior.file import read_prior, shipped_prior
from tso_cli.prior.network import TROUBLES, initial
from tso_cli.render.families import FAMILIES
from tso_cli.render.normalise import normalise
from tso_cli.train.prior.bank import Bank, build_bank
from tso_cli.train.prior.config import PriorConfig
from tso_cli.train.prior.loop import train
from tso_cli.train.prior.loss import Outcome, outcome
from tso_cli.train.prior.scenes import Chances
from tso_cli.train.prior.shapes import Shape, ShapeSet, read_shapes, ruled_shapes
from tso_cli.train.prior.starts import Batch, draw
from tso_cli.train.prior.state import new_state
from tso_cli.workers.pool import cores

from .. import options
from ..charts import legend_beside
from ..harm.scenes import unseen_shapes
from ..options import option
from ..study import Cases, Plan, Progress, Record, Study, Table, crossed
from .confidence import auc
from .shapes import SPLIT
from .summary import rounded

Bits = NDArray[np.bool_]
SHIPPED, WHOLE = "shipped", "all of it"
"""The prior in the package, and a training of the ablation that lacks nothing."""
CURVE = (500, 1000, 2000)
"""Steps of the trainings that lack nothing."""
STEPS, SCENES, BY_RULE, BATCH_SIZE = 1000, 4000, 24, 64
"""Of a training of the ablation."""
MARRED, DEPTH_MAPS = 0.3, 0.35
LEFT_OUT = tuple(FAMILIES)[::2]
"""Families that one training does not see."""
# What is judged: scenes of each set, and batches that are drawn from them.
JUDGED_SCENES, JUDGED_BATCHES, JUDGED_SEED = 400, 60, 1000
WORSE = 1.05
BINS = 10
CLEAN, MARRED_MASK, WITH_DEPTH, TWO = "one mask", "marred mask", "depth map", "two masks"
CONDITIONS = {CLEAN: 0, TWO: 2, WITH_DEPTH: 0, MARRED_MASK: 0}
"""Of starts -> the column of `Outcome.left` that counts."""
STARTS = OTHER, NEAR = "another shape", "near"


@dataclass(frozen=True)
class Training:
    """One prior of the study: what it is trained on, and for how many ``steps``."""

    name: str
    steps: int = STEPS
    meshes: bool = True
    by_rule: int = BY_RULE
    without: tuple[str, ...] = ()
    marred: float = MARRED
    depth_maps: float = DEPTH_MAPS


ABLATION = (
    Training(WHOLE),
    Training("without real meshes", meshes=False),
    Training("without shapes by rule", by_rule=0),
    Training("without every second family", without=LEFT_OUT),
    Training("without marred masks", marred=0.0),
    Training("without depth maps", depth_maps=0.0),
)


def plan(
    progress: Progress,
    *,
    meshes: Path,
    split: Path | None,
    unseen: Path,
    steps: int,
    longest: int,
    scenes: int,
    seed: int,
) -> Plan:
    """Train and judge each prior, and judge the shipped one."""
    trainings = [
        Training(f"{count} steps", count) for count in CURVE if count <= longest and count != steps
    ]
    trainings += [replace(training, steps=steps) for training in ABLATION]
    judged = _Judged(meshes, split or SPLIT, unseen)

    def reporting(doing: str) -> Callable[[int, int, str], None]:
        return lambda done, total, note: progress.report(doing, done, total)

    # The trainings of the curve follow each other, and see the same.
    @lru_cache(maxsize=1)
    def seen_by(training: Training) -> tuple[str, Bank]:
        """The fingerprint of the shapes of a training, and its scenes."""
        shapes = ShapeSet([])
        if training.meshes:
            shapes = judged.read("train")
        if training.by_rule:
            shapes = shapes + ruled_shapes(training.by_rule, seed, training.without)
        chances, drawing = Chances(training.marred, training.depth_maps), reporting("scenes")
        bank = build_bank(
            shapes, scenes, seed, progress=drawing, processes=cores(), chances=chances
        )
        return shapes.fingerprint(), bank

    def trained(training: Training) -> Cases:
        fingerprint, bank = seen_by(replace(training, name="", steps=0))
        config = PriorConfig(
            steps=training.steps,
            batch_size=BATCH_SIZE,
            scenes=scenes,
            precision="bfloat16",
            seed=seed,
        )
        state = new_state(initial(seed), fingerprint, torch.device("cpu"))
        began, stepping = time.process_time(), reporting(training.name)
        if train(bank, config, state, progress=stepping, workers=cores()) == "interrupted":
            raise KeyboardInterrupt
        minutes = (time.process_time() - began) / 60.0
        about = {"training": training.name, "steps": training.steps, "minutes": minutes}
        return judged.cases(about, state.averaged())

    def shipped() -> Cases:
        weights, about = read_prior(shipped_prior())
        done = about.get("settings", {}).get("steps", 0)
        return judged.cases({"training": SHIPPED, "steps": done, "minutes": 0.0}, weights)

    jobs = [({"training": training.name}, partial(trained, training)) for training in trainings]
    settings = {"split": (split or SPLIT).name, "steps": steps, "longest": longest}
    settings |= {"scenes": scenes, "seed": seed}
    return Plan(settings, [({"training": SHIPPED}, shipped), *jobs], "training")


class _Judged:
    """Shapes that no training sees, and what priors make of starts of them."""

    def __init__(self, meshes: Path, split: Path, unseen: Path) -> None:
        self._meshes, self._split, self._unseen = meshes, split, unseen
        self._banks: dict[str, Bank] = {}

    def read(self, part: str) -> ShapeSet:
        """The meshes of a part of the split."""
        return read_shapes(self._meshes, only=read_part(self._split, part))

    def banks(self) -> dict[str, Bank]:
        """By name of the set, made once."""
        if not self._banks:
            ruled = ruled_shapes(4, JUDGED_SEED).shapes
            # Kinds with one shape each are one category together, so that all can be drawn.
            kinds = [
                Shape.of(normalise(read_mesh(shape.path)), shape.name, "unseen", shape.name)
                for shape in unseen_shapes(self._unseen)
            ]
            sets = {
                "validation": self.read("validation"),
                "unseen": ShapeSet(kinds),
                "families": ShapeSet([shape for shape in ruled if shape.category in LEFT_OUT]),
            }
            for name, shapes in sets.items():
                chances = Chances(MARRED, DEPTH_MAPS)
                self._banks[name] = build_bank(
                    shapes, JUDGED_SCENES, JUDGED_SEED, processes=cores(), chances=chances
                )
        return self._banks

    def cases(self, about: Record, weights: Mapping[str, Any]) -> Cases:
        """A case for each set, start and condition; and one of what it says of each trouble."""
        tensors = {
            name: torch.tensor(np.asarray(array, np.float32)) for name, array in weights.items()
        }
        cases: Cases = []
        for name, bank in self.banks().items():
            of = outcomes(tensors, bank)
            # Another shape than one of a kind by itself would be of another kind.
            for start in STARTS[name == "unseen" :]:
                for condition, pass_number in CONDITIONS.items():
                    values = of["left"][of[start] & of[condition], pass_number]
                    row: Record = {"set": name, "start": start, "condition": condition}
                    row |= {"starts": len(values), "left": float(values.mean())}
                    cases.append({**about, **row, "worse": float((values > WORSE).mean())})
            cases.append({**about, "set": name, "start": "", "troubles": doubts(of)})
        return [rounded(case) for case in cases]


def outcomes(weights: Mapping[str, torch.Tensor], bank: Bank) -> dict[str, NDArray[Any]]:
    """What a prior makes of N starts in their first views; of the same ones for every prior.

    Of `STARTS` and `CONDITIONS` [N], which starts they hold for. left : [N, 3], see `Outcome`.
    said, true : [2 N, T], probabilities of troubles, and whether they are the case, in all views.
    foreign_said, foreign : the same of cells, [C] each.
    """
    parts = []
    for number in range(JUDGED_BATCHES):
        batch = draw(bank, np.random.default_rng([JUDGED_SEED, number]), BATCH_SIZE)
        generator = torch.Generator().manual_seed(number)
        with torch.no_grad():
            parts.append(_columns(batch, outcome(weights, batch, generator, second_pass=0.0)))
    return {key: np.concatenate([part[key] for part in parts]) for key in parts[0]}


def _columns(batch: Batch, result: Outcome) -> dict[str, NDArray[Any]]:
    troubles = batch.troubles.numpy() > 0.5  # [B, V, T]
    of = {name: troubles[..., number] for number, name in enumerate(TROUBLES)}
    marred = of["foreign"] | of["hidden"]
    wrong = of["moved"] | of["camera"] | of["outline"] | of["unrelated"] | of["plane"]
    right = ~(wrong | marred)  # [B, V]
    matched = ~batch.counterpart.isnan().any(-1).numpy()
    frame = result.frame
    deep = frame.views["measured"].flatten(2).amax(2)[:, 0].numpy() > 0.0
    # One cell of twenty: those of one mask are alike.
    inside = (frame.distance < 0.0)[:, 0].flatten()[::20].numpy()
    foreign = result.answers.cells.unflatten(0, frame.distance.shape[:2])[:, 0, 0].sigmoid()
    return {
        OTHER: ~matched.any(1),
        NEAR: matched.any(1) & of["shape"][:, 0],
        CLEAN: right[:, 0] & ~deep,
        TWO: right[:, 0] & right[:, 1] & ~deep,
        WITH_DEPTH: right[:, 0] & deep,
        MARRED_MASK: ~wrong[:, 0] & marred[:, 0] & ~deep,
        "left": result.left.double().numpy(),
        "said": result.answers.troubles.sigmoid().double().numpy(),
        "true": troubles.reshape(-1, troubles.shape[-1]),
        "foreign": frame.foreign[:, 0].flatten()[::20].numpy()[inside] > 0.5,
        "foreign_said": foreign.flatten()[::20].double().numpy()[inside],
    }


def doubts(of: Mapping[str, NDArray[Any]]) -> Record:
    """Of each trouble, and of foreign cells: how often, AUC, and error of the probability."""
    columns = dict(zip(TROUBLES, zip(of["said"].T, of["true"].T, strict=True), strict=True))
    columns["a foreign cell"] = of["foreign_said"], of["foreign"]
    return {
        name: rounded(
            {"frequency": float(true.mean()), "AUC": auc(-said, true), "error": _error(said, true)}
        )
        for name, (said, true) in columns.items()
    }


def _error(said: NDArray[np.float64], true: Bits) -> float:
    """Mean distance of probability and frequency over bins, each by its number of cases."""
    number = np.minimum((said * BINS).astype(int), BINS - 1)
    counts, sums, hits = (
        np.bincount(number, values, BINS) for values in (np.ones_like(said), said, true)
    )
    return float(np.abs(sums - hits).sum() / counts.sum())


def conclude(cases: Cases) -> Record:
    """{"left", "worse": {column: {training: value}}, "doubts": {set: {trouble: figures}}}."""
    measured = [case for case in cases if "left" in case]
    tables: Record = {"left": {}, "worse": {}}
    for case in measured:
        column = f"{case['set']}, {case['start']}, {case['condition']}"
        for key, rows in tables.items():
            rows.setdefault(column, {})[case["training"]] = case[key]
    shipped = [case for case in cases if case["training"] == SHIPPED and "troubles" in case]
    doubts = {case["set"]: case["troubles"] for case in shipped}
    trainings = {case["training"]: [case["steps"], case["minutes"]] for case in cases}
    return {**tables, "doubts": doubts, "trainings": trainings}


def tables(record: Record) -> list[Table]:
    trainings = record["trainings"]
    result = []
    for key, title in (("left", "Error left"), ("worse", f"Share of starts over {WORSE}")):
        for subset in dict.fromkeys(column.partition(",")[0] for column in record[key]):
            columns = {
                column.partition(", ")[2]: rows
                for column, rows in record[key].items()
                if column.startswith(subset)
            }
            cells: dict[str, dict[str, Any]] = {
                name: {
                    "steps": steps,
                    "CPU minutes": round(minutes, 1),
                    **{column: rows.get(name) for column, rows in columns.items()},
                }
                for name, (steps, minutes) in trainings.items()
            }
            result.append(crossed(cells, "training", f"{title}: {subset}"))
    for subset, troubles in record["doubts"].items():
        result.append(crossed(troubles, "trouble", f"What the shipped prior says: {subset}"))
    return result


def draw_chart(path: Path, record: Record, overwrite: bool = False) -> None:
    """What is left over the number of starts of a training, and what each part of it brings."""
    trainings, left = record["trainings"], record["left"]
    names = [WHOLE, *(name for name in trainings if name.endswith(" steps"))]
    curve = sorted([*names, SHIPPED], key=lambda name: trainings[name][0])
    chosen = [column for column in left if column.endswith(CLEAN) or column.endswith(WITH_DEPTH)]
    with page(path, overwrite, (8.6, 8.0), dpi=100) as figure:
        above, below = figure.subplots(2, 1)
        places = [BATCH_SIZE * trainings[name][0] for name in curve]
        for number, column in enumerate(chosen):
            values = [left[column][name] for name in curve]
            colour = COLOURS[number // 2 % len(COLOURS)]
            line = "o--" if column.endswith(WITH_DEPTH) else "o-"
            above.plot(places, values, line, color=colour, label=column, markersize=3)
        above.set(xscale="log", xlabel="starts seen", ylabel="error left")
        legend_beside(above)
        rows = [name for name in trainings if name == WHOLE or name.startswith("without")]
        for number, name in enumerate(rows):
            values = [left[column][name] for column in left]
            colour = COLOURS[number % len(COLOURS)]
            below.plot(values, range(len(left)), "o", color=colour, label=name, markersize=5)
        below.set_yticks(range(len(left)), list(left), fontsize=8)
        below.invert_yaxis()
        below.set_xlabel("error left")
        legend_beside(below)


STUDY = Study(
    name="prior",
    values={"WORSE": WORSE},
    parts=("training of a prior",),
    tables=tables,
    draw=draw_chart,
    options=(
        options.MESHES,
        options.SPLIT,
        options.unseen(required=True),
        option("--steps", "Of a training of the ablation.", int, STEPS, least=10),
        option("--longest", "Steps of the longest training.", int, CURVE[-1], least=10),
        option("--scenes", "That each training draws.", int, SCENES, least=10),
        options.SEED,
    ),
    plan=plan,
    conclude=conclude,
)
