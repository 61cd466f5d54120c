"""Images a second of a training step beside the bare network's passes, and beside what their multiply-adds must take."""

from __future__ import annotations

from functools import partial
from typing import Any

import torch
from torch.utils.flop_counter import FlopCounterMode

from ...network.model import BaseNetwork
from ...train.config import PRECISIONS, TrainConfig
from ...train.loop import start
from ...train.sources import shipped_examples
from ...train.speed import ROUNDS, images_per_second
from .timing import Setting

BATCH = 16
# Side of the matrix product, and channels of the convolution, whose rates make the roofline, on the CPU and on a GPU.
SIDE, LARGE_SIDE = 2048, 8192
CHANNELS = 256


def measure(setting: Setting, batch: int = BATCH, side: int | None = None) -> list[dict[str, Any]]:
    """A record for each supervision and precision: seconds a step, images a second of it and of the bare passes.

    What `tso train` prints at its end, on the pictures of the shipped examples; "waiting" is the share of a step in which the
    network waits for its batch. "roofline" is images a second if the multiply-adds of forward and backward were all there is,
    at the rate of a large matrix product or of a large convolution in the same precision, whichever is higher; these have
    records of their own.
    """
    data = shipped_examples()
    records = _rates(setting, side or (SIDE if setting.device.type == "cpu" else LARGE_SIDE))
    rates = {precision: max(r["per_second"] for r in records if r["precision"] == precision) for precision in PRECISIONS}
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


def _rates(setting: Setting, side: int) -> list[dict[str, Any]]:
    """Multiply-adds a second of a large matrix product and of a large convolution, in each precision that training knows.

    Both, because either may be far from what the machine can do: on an AMD processor the product in float32 was seen to run at
    less than half the rate of the convolution, and below that of the network itself.
    """
    setting.report("matrix products and convolutions")
    width = side // 64
    records = []
    for precision in PRECISIONS:
        like: dict[str, Any] = {"dtype": getattr(torch, precision), "device": setting.device}
        matrix, weight = torch.ones(side, side, **like), torch.ones(CHANNELS, CHANNELS, 3, 3, **like)
        pictures = torch.ones(BATCH, CHANNELS, width, width, **like).contiguous(memory_format=torch.channels_last)
        weight = weight.contiguous(memory_format=torch.channels_last)
        timings = setting.race(
            {
                "matrix product": partial(torch.mm, matrix, matrix),
                "convolution": partial(torch.nn.functional.conv2d, pictures, weight, padding=1),
            }
        )
        done = {"matrix product": float(side) ** 3, "convolution": 9.0 * CHANNELS**2 * BATCH * width**2}
        records += [
            setting.record(
                "training rate",
                name,
                timing,
                precision=precision,
                per_second=done[name] / timing.median,
                unit="multiply-adds",
            )
            for name, timing in timings.items()
        ]
    return records
