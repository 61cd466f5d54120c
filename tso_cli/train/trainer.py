"""What the trainings of network and prior share: the loop, the mean of the weights, the log."""

from __future__ import annotations

import json
import math
import threading
from collections import deque
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import torch
from torch import Tensor

from ..errors import InputError, TsoError
from ..io.output import write_file
from ..io.reading import shown
from ..signals import at_interrupt

Progress = Callable[[int, int, str], None]
Drawn = TypeVar("Drawn")


@dataclass(eq=False, kw_only=True)
class Course:
    """What a training has done.

    fingerprint : digest of its data. history : the loss of every step, and its parts.
    average : running mean of each weight; empty without averaging, and before the first step.
    """

    fingerprint: str
    history: list[Any] = field(default_factory=list)
    average: dict[str, Tensor] = field(default_factory=dict)

    @property
    def step(self) -> int:
        """Steps done."""
        return len(self.history)

    def update_average(self, weights: Mapping[str, Tensor], decay: float) -> None:
        """Let the running mean follow: decay * mean + (1 - decay) * weights; 0 keeps no mean.

        The decay is smaller in the first steps (a half after nine), so that the random initial
        weights are forgotten.
        """
        if decay == 0.0:
            return
        with torch.no_grad():
            self.average = self.average or {n: weight.clone() for n, weight in weights.items()}
            share = 1.0 - min(decay, self.step / (self.step + 9.0))
            torch._foreach_lerp_(list(self.average.values()), list(weights.values()), share)


def run(
    state: Course,
    steps: int,
    batches: Generator[Drawn, None, None],
    take: Callable[[Drawn], str],
    *,
    progress: Progress | None = None,
    save: Callable[[], None] | None = None,
    save_every: int = 0,
    stopping: Callable[[bool], bool] = bool,
) -> str:
    """Take steps until ``steps`` are done, or until Ctrl-C; the current step is finished.

    take : one step with a batch; changes the state, and returns a note for ``progress``.
    save : called every ``save_every`` steps (0: never) and at the end.
    stopping : whether to stop, given whether Ctrl-C was pressed here.

    Returns "max_steps" or "interrupted". A second Ctrl-C interrupts at once.
    """
    pressed = threading.Event()
    with at_interrupt(pressed.set, once=True), closing(batches):
        while state.step < steps and not stopping(pressed.is_set()):
            note = take(next(batches))
            if progress:
                progress(state.step, steps, note)
            if save and save_every and state.step % save_every == 0 and state.step < steps:
                save()
        if save:
            save()
    return "max_steps" if state.step >= steps else "interrupted"


def prefetched(
    draw: Callable[[int], Drawn], first: int, steps: int, workers: int
) -> Generator[Drawn, None, None]:
    """The batches of steps ``first`` to ``steps`` - 1; threads draw ``workers`` batches ahead."""
    pool = ThreadPoolExecutor(workers, thread_name_prefix="tso-batch")
    waiting: deque[Future[Drawn]] = deque()
    try:
        for step in range(first, steps):
            waiting.append(pool.submit(draw, step))
            if len(waiting) > workers:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def state_path(path: Path) -> Path:
    """File of the state of a training: base.safetensors -> base.training.safetensors."""
    return path.with_name(f"{path.stem}.training.safetensors")


def resumable(
    path: Path, read: Callable[[Path], Mapping[str, Any]]
) -> tuple[Path, Mapping[str, Any], int]:
    """`state_path`, its metadata and the steps that it has done; InputError without a state."""
    file = state_path(path)
    if not file.exists():
        raise InputError(
            f"{file}: does not exist, expected the state of an unfinished training to resume"
        )
    about = read(file)
    step = about.get("step")
    if not isinstance(step, int) or isinstance(step, bool) or step < 0:
        raise InputError(f"{file}: step in the state is {shown(step)}, expected a whole number")
    return file, about, step


def require_finite(loss: float, step: int, rate: str, save_every: int) -> None:
    """TsoError if a loss is no number, which names the last step that was saved."""
    if not math.isfinite(loss):
        saved = step // save_every * save_every if save_every else 0
        last = f"the last checkpoint is from step {saved}" if saved else "nothing was written"
        raise TsoError(f"the loss became {loss} in step {step + 1} ({rate}); {last}")


def write_log(
    path: Path,
    settings: Mapping[str, Any],
    names: Iterable[str],
    history: Iterable[Sequence[float]],
    overwrite: bool = True,
) -> None:
    """Write the settings, then the losses of every step by ``names``, one JSON object a line."""
    lines = [json.dumps(settings, allow_nan=False)]
    for step, row in enumerate(history, 1):
        lines.append(json.dumps(dict(zip(("step", *names), (step, *row), strict=False))))
    write_file(path, ("\n".join(lines) + "\n").encode(), overwrite)
