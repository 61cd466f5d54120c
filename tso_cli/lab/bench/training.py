"""Images a second of a training step, beside the bare network's passes."""

from __future__ import annotations

from typing import Any

from ...train.config import PRECISIONS, TrainConfig
from ...train.loop import start
from ...train.sources import shipped_examples
from ...train.speed import ROUNDS, images_per_second
from .timing import Records, Setting, record


def measure(setting: Setting, batch: int = 16) -> Records:
    """A record for each supervision and precision, on the images of the shipped examples; see `images_per_second`.

    "waiting" is the share of a step in which the network waits for its batch.
    """
    data = shipped_examples()
    records = []
    for supervision in ("points", "masks"):
        for precision in PRECISIONS:
            setting.report(f"training on {supervision}, {precision}")
            config = TrainConfig(supervision=supervision, batch_size=batch, precision=precision, seed=setting.seed)
            speed = images_per_second(start(data, config), config, data)
            for name, key in (("bare network", "bare"), ("step", "step")):
                fields: dict[str, Any] = {"points": config.points, "side": 64, "batch": batch, "precision": precision}
                fields |= {"images_per_second": speed[key], "added": speed["added"], "waiting": speed["waiting"]}
                seconds = {"median": batch / speed[key], "low": None, "high": None}
                records.append(record("training", f"{supervision}, {name}", **fields, seconds=seconds, runs=ROUNDS))
    return records
