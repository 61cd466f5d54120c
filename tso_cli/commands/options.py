"""What several commands share: options, help in sections, progress, warnings and JSON."""

from __future__ import annotations

import gc
import json
import math
import os
import sys
import time
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import fields
from importlib import import_module
from pathlib import Path
from typing import Any, TypeVar

import click

from ..errors import InputError, TsoError
from ..io.output import check_output

T = TypeVar("T")
SHOW_ALL = "tso.show_all"
"""Of a context's ``meta``: whether its help shows every option."""


class FilePath(click.Path):
    """A path as `pathlib.Path`; the readers check it, so that their messages are the same everywhere."""

    def __init__(self) -> None:
        super().__init__(path_type=Path)


class AutoOrInteger(click.types.IntParamType):
    """A whole number; None for auto."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        return None if value == "auto" else super().convert(value, param, ctx)


FIT = Path("fit")
"""What `--camera` takes instead of a file, to estimate the camera."""


class CameraPath(FilePath):
    """A camera file, or ``FIT``; a file of that name, written ./fit, becomes absolute."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        path = super().convert(value, param, ctx)
        return path.absolute() if path == FIT and str(value) != str(FIT) else path


class LazyGroup(click.Group):
    """A click group of modules that each hold a ``command``, imported to run it: `tso --help` must not wait for torch.

    sections : heading -> name of a command -> (its module, its line of help).
    """

    def __init__(
        self, *args: Any, sections: dict[str, dict[str, tuple[str, str]]], **kwargs: Any
    ) -> None:
        super().__init__(*args, **kwargs)
        self.sections = sections
        self._modules = {
            name: module for section in sections.values() for name, (module, _) in section.items()
        }

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(self._modules)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in self._modules:
            return None
        command: click.Command = import_module(self._modules[cmd_name]).command
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        for heading, commands in self.sections.items():
            with formatter.section(heading):
                formatter.write_dl([(name, line) for name, (_, line) in commands.items()])


class Command(click.Command):
    """A command whose help shows defaults, and options under headings.

    headings : name of a parameter -> the heading that it and those after it stand under.
    brief : names of the options that --help shows; --help-all shows every one. Without any, --help does.
    """

    def __init__(
        self, *args: Any, headings: Mapping[str, str], brief: Sequence[str] = (), **kwargs: Any
    ) -> None:
        super().__init__(*args, **kwargs)
        self.context_settings["show_default"] = True
        self.headings, self.brief = headings, brief
        if brief:
            self.params.append(
                click.Option(
                    ["--help-all"],
                    is_flag=True,
                    is_eager=True,
                    expose_value=False,
                    callback=_show_all,
                    help="Show every option.",
                )
            )

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        brief = bool(self.brief) and not ctx.meta.get(SHOW_ALL)
        heading, sections = "Options", dict[str, list[tuple[str, str]]]()
        for parameter in self.get_params(ctx):
            if brief and parameter.name not in self.brief and not parameter.is_eager:
                continue
            heading = heading if brief else self.headings.get(parameter.name or "", heading)
            if isinstance(parameter, click.Option) and (record := parameter.get_help_record(ctx)):
                sections.setdefault(heading, []).append(record)
        for heading, records in sections.items():
            with formatter.section(heading):
                formatter.write_dl(records)


def _show_all(ctx: click.Context, parameter: click.Parameter, value: bool) -> None:
    if value and not ctx.resilient_parsing:
        ctx.meta[SHOW_ALL] = True
        click.echo(ctx.get_help())
        ctx.exit()


overwrite = click.option("--overwrite", is_flag=True, help="Replace an output that exists.")
seed = click.option(
    "--seed",
    type=click.IntRange(0, 2**63 - 1),
    default=0,
    show_default=True,
    help="Seed of everything random.",
)
as_json = click.option("--json", "as_json", is_flag=True, help="Print one JSON document on stdout.")
device = click.option(
    "--device",
    default="cpu",
    show_default=True,
    help="cpu, cuda, cuda:1, mps or auto; GPU support (Triton kernels) is experimental.",
)


def pick(kind: type[T], chosen: Mapping[str, Any]) -> T:
    """The dataclass ``kind`` from the options that it has fields for."""
    names = {field.name for field in fields(kind)}  # type: ignore[arg-type]
    return kind(**{name: value for name, value in chosen.items() if name in names})


def require_output(path: Path, suffix: str, overwrite: bool) -> None:
    """InputError for an output that has another suffix or cannot be written (`check_output`)."""
    if path.suffix.lower() != suffix:
        raise InputError(f"{path}: the suffix is {path.suffix!r}, expected {suffix}")
    check_output(path, overwrite)


@contextmanager
def loading() -> Iterator[None]:
    """Import without garbage collection: torch makes many objects, and scanning them takes a tenth of a second."""
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        gc.enable()


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Name ``path`` where the work on it fails."""
    try:
        yield
    except InputError:
        raise
    except TsoError as error:
        raise TsoError(f"{path}: {error}") from None


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
    """Collect the texts of all warnings in a list; show them too unless ``quiet``."""
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
    """Progress on stderr: a bar with the time left on a terminal, else a line every tenth of the work or 15 seconds.

    Nothing is shown in the first ``delay`` seconds.
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
        # A line that wraps cannot be overwritten: shorten the bar until it fits.
        width = min(40, _columns() - len(f"{self.label} [] {total}/{total} {note}, 00:00 left") - 1)
        words += self._left(now, done, total)
        filled = done * width // max(total, 1)
        bar = f"[{'#' * filled}{'.' * (width - filled)}] " if width > 0 else ""
        self._open = done != total
        click.echo(f"\r{self.label} {bar}{words}\x1b[K", err=True, nl=not self._open)

    def close(self) -> None:
        """End the line of a bar that stopped early."""
        if self._open:
            log("")
        self._open = False

    def _left(self, now: float, done: int, total: int) -> str:
        began, before = self._first or (now, done)
        if not before < done < total:
            return ""
        seconds = math.ceil((now - began) / (done - before) * (total - done))
        return f", {seconds // 60}:{seconds % 60:02} left"


def _columns() -> int:
    """Width of the terminal."""
    try:
        return os.get_terminal_size(sys.stderr.fileno()).columns or 80
    except OSError:
        return 80
