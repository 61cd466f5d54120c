"""The files of a training."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from ...errors import InputError
from ...io.output import check_output
from .. import options


@dataclass
class TrainOutputs:
    """The files that a training writes, and whether it continues an earlier training."""

    output: Path
    log_file: Path | None
    resume: bool
    overwrite: bool

    def check(self) -> None:
        """InputError for an output that cannot be written."""
        from ...train.trainer import state_path

        replace_files, state = self.overwrite or self.resume, state_path(self.output)
        options.require_output(self.output, ".safetensors", replace_files)
        check_output(state, replace_files)
        if self.log_file is not None:
            check_output(self.log_file, replace_files)
            if self.log_file.resolve() in (self.output.resolve(), state.resolve()):
                raise InputError(
                    f"--log-file {self.log_file}: is the checkpoint or its state, "
                    "expected a file of its own"
                )

    def log_resumed(self, done: int, steps: int) -> None:
        """Say how far the training is that goes on."""
        complete = f"the training is complete, with {done} steps; --steps asks for more"
        options.log(f"tso: {complete if done == steps else f'resuming after {done} steps'}")

    def save(
        self, write: Callable[[Path, bool], None], write_log: Callable[[Path, bool], None]
    ) -> None:
        """Write checkpoint and state with ``write``, and the log; both take path and overwrite.

        The first call raises InputError if one of the files has appeared since `check`.
        """
        self.check()
        write(self.output, self.overwrite or self.resume)
        if self.log_file is not None:
            write_log(self.log_file, self.overwrite or self.resume)
        self.overwrite = True  # from now on the files are our own
