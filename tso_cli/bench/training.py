"""Images a second of a training step beside the bare network's passes."""

from __future__ import annotations

from typing import Any

from ..train.config import PRECISIONS, TrainConfig
from ..train.loop import start
from ..train.sources import shipped_examples
from ..train.speed import ROUNDS, images_per_second
from .timing import Setting

BATCH = 16


def measure(setting: Setting, batch: int = BATCH) -> list[dict[str, Any]]:
    """A record for each supervision and precision: seconds a step, images a second of it and of the bare passes.

    What `tso train` prints at its end, on the pictures of the shipped examples.
    """
    data = shipped_examples()
    records = []
    for supervision in ("points", "masks"):
        for precision in PRECISIONS:
            setting.report(f"training on {supervision}, {precision}")
            config = TrainConfig(
                supervision=supervision, batch_size=batch, precision=precision, seed=setting.seed, device=str(setting.device)
            )
            found = images_per_second(start(data, config), config, data)
            for name, key in (("bare network", "bare"), ("step", "step")):
                seconds = batch / found[key]
                records.append(
                    setting.record(
                        f"training, {supervision}",
                        name,
                        points=config.points,
                        side=64,
                        batch=batch,
                        seconds={"median": seconds, "low": None, "high": None},
                        runs=ROUNDS,
                        precision=precision,
                        images_per_second=found[key],
                        added=found["added"],
                    )
                )
    return records
