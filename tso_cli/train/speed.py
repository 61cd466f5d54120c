"""How much the projector, the losses and the data add to the network's own forward and backward pass."""

from __future__ import annotations

import time
from collections.abc import Callable
from statistics import median

import torch

from .batches import Batch
from .config import TrainConfig
from .data import TrainingData
from .loop import ahead
from .processes import Processes
from .state import TrainingState
from .step import batch_loss, draw_step, images_of

ROUNDS = 5


def images_per_second(
    state: TrainingState, config: TrainConfig, data: TrainingData, masked: TrainingData | None = None
) -> dict[str, float]:
    """Images a second of the bare network and of a whole step, measured by turns in this process.

    Returns
    -------
    bare : forward and backward of the network alone, on images that are there.
    step : drawing the batch, the same passes, projector and losses. The optimiser is in neither.
    added : by how much the step takes longer than the bare passes, as a share.
    waiting : share of such steps in which the network waits for a batch, where threads prepare them ahead as in `train`.
    """
    network = state.network
    device = next(network.parameters()).device

    def draw(step: int) -> list[Batch]:
        return draw_step(data, masked, config, Processes(), step)

    def passes(batches: list[Batch], whole: bool) -> None:
        network.zero_grad(set_to_none=True)
        with torch.autocast(device.type, torch.bfloat16, enabled=config.precision == "bfloat16"):
            clouds = [network(images_of(batch, device)) for batch in batches]
        points = [cloud.float() for cloud in clouds]
        if whole:
            loss, *_ = batch_loss(points, batches, config, config.affinity_weight)
        else:
            loss = torch.stack([cloud.sum() for cloud in points]).sum()
        loss.backward()

    def timed(work: Callable[[], None]) -> float:
        if device.type == "cuda":
            torch.cuda.synchronize(device)
        start = time.perf_counter()
        work()
        if device.type == "cuda":
            torch.cuda.synchronize(device)
        return time.perf_counter() - start

    bare, whole, waits, works = [], [], [], []
    for step, batches in enumerate([draw(step) for step in range(ROUNDS + 1)]):
        bare.append(timed(lambda: passes(batches, False)))  # noqa: B023 - called at once
        whole.append(timed(lambda: passes(draw(step), True)))  # noqa: B023
    with ahead(draw, 0, ROUNDS + 1, config.workers) as take:
        for _ in range(ROUNDS + 1):
            begun = time.perf_counter()
            batches = take()
            waits.append(time.perf_counter() - begun)
            works.append(timed(lambda: passes(batches, True)))  # noqa: B023
    network.zero_grad(set_to_none=True)
    # The first round warms up.
    bare_seconds, whole_seconds, waited = median(bare[1:]), median(whole[1:]), sum(waits[1:])
    return {
        "bare": config.batch_size / bare_seconds,
        "step": config.batch_size / whole_seconds,
        "added": whole_seconds / bare_seconds - 1.0,
        "waiting": waited / (waited + sum(works[1:])),
    }
