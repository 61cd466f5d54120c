"""Images a second of a training step beside the bare network's passes, and beside what their multiply-adds must take."""

from __future__ import annotations

from typing import Any

import torch
from torch.utils.flop_counter import FlopCounterMode

from ..network import BaseNetwork
from ..train.config import PRECISIONS, TrainConfig
from ..train.loop import start
from ..train.sources import shipped_examples
from ..train.speed import ROUNDS, images_per_second
from .timing import Setting

BATCH = 16
# Side of the matrix product whose rate is the roofline, on the CPU and on a GPU.
SIDE, LARGE_SIDE = 2048, 8192


def measure(setting: Setting, batch: int = BATCH, side: int | None = None) -> list[dict[str, Any]]:
    """A record for each supervision and precision: seconds a step, images a second of it and of the bare passes.

    What `tso train` prints at its end, on the pictures of the shipped examples; "waiting" is the share of a step in which the
    network waits for its batch. "roofline" is images a second at the rate of a large matrix product in the same precision,
    which has records of its own, if the multiply-adds of forward and backward were all there is.
    """
    data = shipped_examples()
    records = _products(setting, side or (SIDE if setting.device.type == "cpu" else LARGE_SIDE))
    rates = {record["precision"]: record["per_second"] for record in records}
    for supervision in ("points", "masks"):
        for precision in PRECISIONS:
            setting.report(f"training on {supervision}, {precision}")
            config = TrainConfig(
                supervision=supervision, batch_size=batch, precision=precision, seed=setting.seed, device=str(setting.device)
            )
            state = start(data, config)
            needed = multiply_adds(state.network)
            found = images_per_second(state, config, data)
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
                        waiting=found["waiting"],
                        multiply_adds=needed,
                        roofline=rates[precision] / needed,
                    )
                )
    return records


def multiply_adds(network: BaseNetwork) -> int:
    """Of forward and backward on one image [3, 64, 64], in convolutions and matrix products."""
    image = torch.zeros(1, 3, 64, 64, device=next(network.parameters()).device)
    with FlopCounterMode(display=False) as counted:
        network(image).sum().backward()
    network.zero_grad(set_to_none=True)
    return counted.get_total_flops() // 2


def _products(setting: Setting, side: int) -> list[dict[str, Any]]:
    """Multiply-adds a second of the product of two square matrices, in each precision that training knows."""
    setting.report("matrix products")
    found = {}
    for precision in PRECISIONS:
        matrix = torch.ones(side, side, dtype=getattr(torch, precision), device=setting.device)
        found[precision] = lambda matrix=matrix: matrix @ matrix
    return [
        setting.record(
            "matrix product", name, timing, precision=name, per_second=float(side) ** 3 / timing.median, unit="multiply-adds"
        )
        for name, timing in setting.race(found).items()
    ]
