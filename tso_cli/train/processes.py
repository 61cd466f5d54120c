"""Data-parallel training: each process works on its part of every batch; gradients are averaged.

`torchrun --nproc-per-node 2 -m tso_cli train ...` starts the processes. They communicate through
gloo on CPUs and through nccl on GPUs.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import torch
from torch import Tensor

from ..errors import InputError


@dataclass(frozen=True)
class Processes:
    """The ``rank`` of this process among ``count`` processes; (0, 1) trains alone."""

    rank: int = 0
    count: int = 1

    @property
    def first(self) -> bool:
        """Whether this process writes files and reports progress."""
        return self.rank == 0

    def average(self, values: Iterable[Tensor]) -> None:
        """Replace each tensor by its mean over the processes, in one message."""
        tensors = list(values)
        if self.count == 1 or not tensors:
            return
        joined = torch.cat([tensor.reshape(-1) for tensor in tensors])
        torch.distributed.all_reduce(joined)
        joined /= self.count
        parts = joined.split([tensor.numel() for tensor in tensors])
        for tensor, part in zip(tensors, parts, strict=True):
            tensor.copy_(part.view_as(tensor))

    def any(self, flag: bool, device: torch.device) -> bool:
        """Whether ``flag`` is set in any process."""
        if self.count == 1:
            return flag
        count = torch.tensor(float(flag), device=device)
        torch.distributed.all_reduce(count)
        return bool(count.item() > 0.0)

    def wait(self) -> None:
        """Wait until every process has called this."""
        if self.count > 1:
            torch.distributed.barrier()


@contextmanager
def joined(device: str) -> Iterator[tuple[Processes, str]]:
    """Join the processes that `torchrun` started, until the end of the block.

    Without `torchrun` this process trains alone. Yields the processes and the device of this
    process, on GPUs "cuda:LOCAL_RANK". Raises InputError if there are fewer GPUs than processes.
    """
    if int(os.environ.get("WORLD_SIZE", "1")) <= 1:
        yield Processes(), device
        return
    cuda = device.startswith("cuda") or (device == "auto" and torch.cuda.is_available())
    if cuda:
        local, gpus = int(os.environ.get("LOCAL_RANK", "0")), torch.cuda.device_count()
        if local >= gpus:
            raise InputError(
                f"process {local} of this machine has no GPU of its own, "
                f"expected at most {gpus} processes"
            )
        device = f"cuda:{local}"
        torch.cuda.set_device(local)
    torch.distributed.init_process_group("nccl" if cuda else "gloo")
    try:
        yield Processes(torch.distributed.get_rank(), torch.distributed.get_world_size()), device
    finally:
        torch.distributed.destroy_process_group()
