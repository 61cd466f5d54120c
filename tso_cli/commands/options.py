"""Options that several commands share."""

from __future__ import annotations

import gc
import json
import math
import os
import signal
import sys
import threading
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click

# What `--camera` takes instead of a file.
FIT = Path("fit")


class FilePath(click.Path):
    """A path as `pathlib.Path`. Whether it can be read is the reader's to say, in one voice for every file."""

    def __init__(self) -> None:
        super().__init__(path_type=Path)


class CameraPath(FilePath):
    """A camera file, or the word `fit`: that stays the path ``FIT``; a file of that name, written ./fit, is made absolute."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        path = super().convert(value, param, ctx)
        return path.absolute() if path == FIT and str(value) != str(FIT) else path


overwrite = click.option("--overwrite", is_flag=True, help="Replace an output that exists.")
seed = click.option(
    "--seed", type=click.IntRange(0, 2**63 - 1), default=0, show_default=True, help="Seed of everything random."
)
as_json = click.option("--json", "as_json", is_flag=True, help="Print one JSON document on stdout.")
device = click.option("--device", default="cpu", show_default=True, help="cpu, cuda, cuda:1, mps or auto.")


@contextmanager
def loading() -> Iterator[None]:
    """For imports: looking for garbage among what a large library has just made takes a tenth of a second and finds none."""
    collecting = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        if collecting:
            gc.enable()


@contextmanager
def terminated_as_interrupted() -> Iterator[None]:
    """SIGTERM ends the work as Ctrl-C does, so that nothing half done is left."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def echo_json(document: Any) -> None:
    """Print exactly one JSON document; numbers that are not finite become null."""
    click.echo(json.dumps(_plain(document), indent=2, allow_nan=False))


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, Path):
        return str(value)
    if hasattr(value, "item"):  # numpy scalars
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value


def log(message: str) -> None:
    """One line on stderr."""
    click.echo(message, err=True)


@contextmanager
def collected_warnings(quiet: bool) -> Iterator[list[str]]:
    """A list that takes the text of every warning that is issued; they are shown as ever unless ``quiet``."""
    show, texts = warnings.showwarning, []

    def collect(message: Warning | str, *rest: Any, **named: Any) -> None:
        texts.append(str(message))
        if not quiet:
            show(message, *rest, **named)

    warnings.showwarning = collect
    try:
        yield texts
    finally:
        warnings.showwarning = show


class ProgressBar:
    """A bar with the time left on stderr while it is a terminal, else a line every tenth of the work or 15 seconds.

    Parameters
    ----------
    label : what is being done.
    delay : seconds before anything is shown, so that quick work stays silent.
    """

    def __init__(self, label: str, delay: float = 1.0) -> None:
        self.label = label
        self._terminal = sys.stderr.isatty()
        self._shown = -1
        self._open = False
        self._first: tuple[float, int] | None = None
        self._due = time.monotonic() + delay
        self._pause = 1.0 if self._terminal else 15.0

    def __call__(self, done: int, total: int, note: str = "") -> None:
        """Show ``done`` of ``total``."""
        mark = done * (40 if self._terminal else 10) // max(total, 1)
        now = time.monotonic()
        self._first = self._first or (now, done)
        if self._shown < 0 and now < self._due:
            return
        if mark == self._shown and now < self._due and not (done == total and self._terminal):
            return
        self._due = now + self._pause
        self._shown = mark
        words = f"{done}/{total} {note}".rstrip()
        if not self._terminal:
            log(f"{self.label} {words}")
            return
        # A line that wraps cannot be written over: what does not fit is the bar's to save.
        width = min(40, _columns() - len(f"{self.label} [] {total}/{total} {note}, 00:00 left") - 1)
        words += self._left(now, done, total)
        filled = done * width // max(total, 1)
        bar = f"[{'#' * filled}{'.' * (width - filled)}] " if width > 0 else ""
        self._open = done != total
        click.echo(f"\r{self.label} {bar}{words}\x1b[K", err=True, nl=not self._open)

    def close(self) -> None:
        """End the line of a bar that did not come to its end."""
        if self._open:
            log("")
        self._open = False

    def _left(self, now: float, done: int, total: int) -> str:
        assert self._first is not None
        began, before = self._first
        if not before < done < total:
            return ""
        seconds = math.ceil((now - began) / (done - before) * (total - done))
        return f", {seconds // 60}:{seconds % 60:02} left"


def _columns() -> int:
    """Of the terminal that stderr is."""
    try:
        return os.get_terminal_size(sys.stderr.fileno()).columns or 80
    except OSError:
        return 80
