"""Several processes that train one network: each works on its share of every batch, gradients are averaged.

`torchrun --nproc-per-node 2 -m tso_cli train ...` starts them; gloo joins them on CPUs, nccl on GPUs.
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
    """This process's ``rank`` among ``count``; (0, 1) trains alone."""

    rank: int = 0
    count: int = 1

    @property
    def first(self) -> bool:
        """Whether this process is the one that writes and speaks."""
        return self.rank == 0

    def average(self, values: Iterable[Tensor]) -> None:
        """Replace each tensor by its mean over the processes; one message for all of them."""
        tensors = list(values)
        if self.count == 1 or not tensors:
            return
        joined = torch.cat([tensor.reshape(-1) for tensor in tensors])
        torch.distributed.all_reduce(joined)
        joined /= self.count
        start = 0
        for tensor in tensors:
            tensor.copy_(joined[start : start + tensor.numel()].view_as(tensor))
            start += tensor.numel()

    def any(self, flag: bool, device: torch.device) -> bool:
        """Whether ``flag`` is set in any process."""
        if self.count == 1:
            return flag
        asked = torch.tensor(float(flag), device=device)
        torch.distributed.all_reduce(asked)
        return bool(asked.item() > 0.0)

    def wait(self) -> None:
        """Until every process is here."""
        if self.count > 1:
            torch.distributed.barrier()


def launched() -> bool:
    """Whether this process is one of several that `torchrun` started."""
    return int(os.environ.get("WORLD_SIZE", "1")) > 1


@contextmanager
def joined(device: str) -> Iterator[tuple[Processes, str]]:
    """Join the processes that `torchrun` started, until the end of the block; alone if it started none.

    Yields
    ------
    processes, device : with "cuda" or "auto" on a machine with GPUs, each process gets its own, "cuda:LOCAL_RANK".

    Raises
    ------
    InputError
        There are more processes on this machine than GPUs.
    """
    if not launched():
        yield Processes(), device
        return
    cuda = device.startswith("cuda") or (device == "auto" and torch.cuda.is_available())
    if cuda:
        local, gpus = int(os.environ.get("LOCAL_RANK", "0")), torch.cuda.device_count()
        if local >= gpus:
            raise InputError(f"process {local} of this machine has no GPU of its own, expected at most {gpus} processes")
        device = f"cuda:{local}"
        torch.cuda.set_device(local)
    torch.distributed.init_process_group("nccl" if cuda else "gloo")
    try:
        yield Processes(torch.distributed.get_rank(), torch.distributed.get_world_size()), device
    finally:
        torch.distributed.destroy_process_group()
