"""Speed of a training step compared with the bare network."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import closing
from statistics import median

import torch

from .batches import Batch
from .config import TrainConfig
from .data import TrainingData
from .loop import prefetched
from .processes import Processes
from .state import TrainingState
from .step import batch_loss, draw_step, predict


def images_per_second(
    state: TrainingState,
    config: TrainConfig,
    data: TrainingData,
    masked: TrainingData | None = None,
) -> dict[str, float]:
    """Images per second, measured alternately in this process.

    Returns
    -------
    "bare" : images per second of forward and backward passes of the network.
    "step" : images per second of a step, which also draws the batch and has projector and losses.
    Neither has the optimiser. "added" : relative increase in time from "bare" to "step". "waiting"
    : share of a step in which the network waits for a batch that threads prepare ahead as in
    `train`.
    """
    network = state.network
    device = next(network.parameters()).device

    def draw(step: int) -> list[Batch]:
        return draw_step(data, masked, config, Processes(), step)

    def bare_passes(batches: list[Batch]) -> None:
        network.zero_grad(set_to_none=True)
        clouds = predict(network, batches, config.precision)
        torch.stack([cloud.sum() for cloud in clouds]).sum().backward()

    def passes(batches: list[Batch]) -> None:
        network.zero_grad(set_to_none=True)
        clouds = predict(network, batches, config.precision)
        batch_loss(clouds, batches, config, config.affinity_weight)[0].backward()

    def seconds(work: Callable[..., object], *arguments: object) -> float:
        if device.type == "cuda":
            torch.cuda.synchronize(device)
        start = time.perf_counter()
        work(*arguments)
        if device.type == "cuda":
            torch.cuda.synchronize(device)
        return time.perf_counter() - start

    rounds = 1 + 5  # the first warms up, the result is the median of the others
    drawn = [draw(step) for step in range(rounds)]
    rows = [
        (seconds(bare_passes, batches), seconds(lambda i: passes(draw(i)), step))
        for step, batches in enumerate(drawn)
    ]
    waits = []
    with closing(prefetched(draw, 0, rounds, config.workers)) as upcoming:
        for _ in range(rounds):
            start = time.perf_counter()
            batches = next(upcoming)
            waits.append((time.perf_counter() - start, seconds(passes, batches)))
    network.zero_grad(set_to_none=True)
    bare, step = (median(column) for column in zip(*rows[1:], strict=True))
    waiting, working = (sum(column) for column in zip(*waits[1:], strict=True))
    return {
        "bare": config.batch_size / bare,
        "step": config.batch_size / step,
        "added": step / bare - 1.0,
        "waiting": waiting / (waiting + working),
    }
