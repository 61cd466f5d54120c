"""What several commands share: groups, options, help, tables, progress, warnings and JSON."""

from __future__ import annotations

import gc
import json
import math
import os
import shlex
import sys
import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import fields
from importlib import import_module
from pathlib import Path
from typing import Any, TypeVar

import click

from ..errors import InputError, TsoError
from ..io.output import require_output as require_output
from ..io.shipped import DEFAULT, LEARNED, NO_PRIOR

T = TypeVar("T")
CONTEXT: dict[str, Any] = {"help_option_names": ["-h", "--help"], "max_content_width": 100}
"""Settings of the context of every command."""
SHOW_ALL = "tso.show_all"
"""Key of a context's ``meta``: whether the help shows every option."""
CONFIG = "tso.config"
"""Key of a context's ``meta``: the file of --config."""
FIT = Path("fit")
"""What `--camera` takes instead of a file, to estimate the camera."""
WORDS = {"camera": (str(FIT),), "checkpoint": (DEFAULT,), "prior": (LEARNED, NO_PRIOR)}
"""Words that stand in place of a file, by the name of the option."""


class FilePath(click.Path):
    """A path as `pathlib.Path`; the readers check it, so their messages are the same everywhere.

    words : that stand in place of a file. A file of that name, written ./fit, becomes absolute.
    """

    def __init__(self, *words: str) -> None:
        super().__init__(path_type=Path)
        self.words = words

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        path = Path(str(super().convert(value, param, ctx)))
        return path.absolute() if str(path) in self.words and str(value) != str(path) else path


PATH = FilePath()


class AutoOrInteger(click.types.IntParamType):
    """A whole number, or None for auto."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        return None if value == "auto" else super().convert(value, param, ctx)


class Whole(click.types.IntParamType):
    """A whole number from ``least`` to ``most``; `click.IntRange` would add both to the help."""

    def __init__(self, least: int | None = None, most: int | None = None) -> None:
        self.least, self.most = least, most

    @property
    def range(self) -> str:
        """The limits in words, after "a whole number"."""
        lower = "" if self.least is None else f" from {self.least}"
        return lower if self.most is None else f"{lower} to {self.most}"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        number = super().convert(value, param, ctx)
        if self.least is not None and number < self.least:
            self.fail(f"{number} is too small, expected {self.least} or more.", param, ctx)
        if self.most is not None and number > self.most:
            self.fail(f"{number} is too large, expected at most {self.most}.", param, ctx)
        return number


class LazyGroup(click.Group):
    """Commands that are imported when they are run, so that `tso --help` does not wait for torch.

    Without a command the group prints its help on stderr and exits with 2, with every version of
    click.

    Parameters
    ----------
    sections : heading -> name of a command -> (its module, its line of help). The module holds the
        command as ``command``. Commands of a section that have the same line share a row.
    """

    def __init__(
        self, *args: Any, sections: dict[str, dict[str, tuple[str, str]]], **kwargs: Any
    ) -> None:
        super().__init__(*args, **kwargs)
        self.sections = sections
        self._modules = {
            name: module for section in sections.values() for name, (module, _) in section.items()
        }
        _complete(self)

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(self._modules)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        return _complete(self.load(cmd_name)) if cmd_name in self._modules else None

    def load(self, name: str) -> click.Command:
        """Import the command ``name``, which is one of the group."""
        command: click.Command = import_module(self._modules[name]).command
        return command

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[Any]:
        """The names that begin with ``incomplete``, without an import of their commands."""
        from click.shell_completion import CompletionItem

        return [
            CompletionItem(name, help=line)
            for section in self.sections.values()
            for name, (_, line) in section.items()
            if name.startswith(incomplete)
        ] + click.Command.shell_complete(self, ctx, incomplete)

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        if not args and not ctx.resilient_parsing:
            click.echo(ctx.get_help(), err=True)
            ctx.exit(2)
        return super().parse_args(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        sections = {heading: _rows(commands) for heading, commands in self.sections.items()}
        width = max(len(names) for rows in sections.values() for names, _ in rows)
        for heading, rows in sections.items():
            with formatter.section(heading):
                formatter.write_dl([(names.ljust(width), line) for names, line in rows])


def _rows(commands: dict[str, tuple[str, str]]) -> list[tuple[str, str]]:
    """(names, line of help) of the commands of a section."""
    names: dict[str, list[str]] = {}
    for name, (_, line) in commands.items():
        names.setdefault(line, []).append(name)
    return [(", ".join(sharing), line) for line, sharing in names.items()]


class Command(click.Command):
    """A command whose help shows defaults, and options under headings.

    Parameters
    ----------
    headings : name of a parameter -> the heading above it and above the parameters after it.
    brief : names of the options that --help shows; --help-all shows every option. If empty, both
        show every option.
    """

    def __init__(
        self, *args: Any, headings: Mapping[str, str], brief: Sequence[str] = (), **kwargs: Any
    ) -> None:
        super().__init__(*args, **kwargs)
        self.context_settings["show_default"] = True
        self.headings, self.brief = headings, brief

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        brief = bool(self.brief) and not ctx.meta.get(SHOW_ALL)
        heading, sections = "Options", dict[str, list[tuple[str, str]]]()
        for parameter in self.get_params(ctx):
            help_itself = not {"--help", "--help-all"}.isdisjoint(parameter.opts)
            if brief and parameter.name not in self.brief and not help_itself:
                continue
            heading = heading if brief else self.headings.get(parameter.name or "", heading)
            if isinstance(parameter, click.Option) and (record := parameter.get_help_record(ctx)):
                sections.setdefault(heading, []).append(record)
        for heading, records in sections.items():
            with formatter.section(heading):
                formatter.write_dl(records)


def _complete(command: click.Command) -> click.Command:
    """Give ``command`` what all commands have: --help-all, and N and X for numbers in its help."""
    if any(parameter.name == "help_all" for parameter in command.params):
        return command
    for parameter in command.params:
        if isinstance(parameter, click.Option) and parameter.nargs == 1:
            if isinstance(parameter.type, click.types.IntParamType):
                parameter.metavar = parameter.metavar or "N"
            elif isinstance(parameter.type, click.types.FloatParamType):
                parameter.metavar = parameter.metavar or "X"
    command.params.append(
        click.Option(
            ["--help-all"],
            is_flag=True,
            is_eager=True,
            expose_value=False,
            callback=_show_all,
            hidden=not getattr(command, "brief", ()),  # it would show what --help shows
            help="Show every option and exit.",
        )
    )
    return command


def _show_all(ctx: click.Context, parameter: click.Parameter, value: bool) -> None:
    if value and not ctx.resilient_parsing:
        ctx.meta[SHOW_ALL] = True
        click.echo(ctx.get_help())
        ctx.exit()


def listing(table: Callable[[], Mapping[str, str]]) -> Callable[..., Any]:
    """The callback of an option that takes the word `list`: print ``table()`` and exit with 0.

    The table is name -> what it means. The option has to be eager, so that `tso COMMAND --option
    list` needs no arguments. ``table`` is called only then: it may import.
    """

    def print_if_asked(ctx: click.Context, parameter: click.Parameter, value: Any) -> Any:
        asked = value == "list" or (isinstance(value, tuple) and "list" in value)
        if asked and not ctx.resilient_parsing:
            rows = table()
            width = max(map(len, rows), default=0)
            for name, words in rows.items():
                click.echo(f"{name:{width}}  {words}")
            ctx.exit()
        return value

    return print_if_asked


def option(name: str, help: str, *names: str, **settings: Any) -> Callable[..., Any]:
    """A `click.option` with its help; ``names`` are further names and the parameter's."""
    return click.option(name, *names, help=help, **settings)


def flag(name: str, help: str, *names: str) -> Callable[..., Any]:
    """An option without a value."""
    return option(name, help, *names, is_flag=True)


def choice(name: str, help: str, *values: str) -> Callable[..., Any]:
    """An option that takes one of ``values``; the first is the default."""
    return option(name, help, type=click.Choice(values), default=values[0])


def output(help: str, **settings: Any) -> Callable[..., Any]:
    """The option that names what a command writes."""
    return click.option("-o", "--output", type=PATH, help=help, **settings)


overwrite = flag("--overwrite", "Replace outputs that exist.")
seed = option(
    "--seed", "Seed of all random numbers.", type=Whole(0, 2**63 - 1), default=0, show_default=True
)
as_json = flag("--json", "Print one JSON document on stdout.", "as_json")


def _formats() -> dict[str, str]:
    """The table that `--camera-format list` prints."""
    from ..io.cameras import FORMATS

    return {name: words for name, (words, _) in FORMATS.items()}


camera_format = option(
    "--camera-format",
    "Format of the camera file, if the content does not tell; `list` lists all.",
    metavar="NAME",
    is_eager=True,
    callback=listing(_formats),
)
object_id = option(
    "--object",
    "Object of a BOP scene that has several.",
    "object_id",
    type=Whole(0),
    metavar="ID",
)
label = option(
    "--label",
    "Label of the object in masks that show several; R,G,B in coloured ones.",
    metavar="N",
)
mask_index = option(
    "--mask-index",
    "Place of the object's mask in an array or list of several masks.",
    type=Whole(0),
    metavar="N",
)
device = option(
    "--device",
    "cpu, cuda, cuda:1, mps or auto. GPU support (Triton kernels) is experimental.",
    default="cpu",
    show_default=True,
    metavar="DEVICE",
)


def pick(kind: type[T], chosen: Mapping[str, Any]) -> T:
    """The dataclass ``kind``, made of the options that are its fields."""
    names = {field.name for field in fields(kind)}  # type: ignore[arg-type]
    return kind(**{name: value for name, value in chosen.items() if name in names})


@contextmanager
def loading() -> Iterator[None]:
    """Import without garbage collection: torch makes many objects, scanning them takes 0.1 s."""
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        gc.enable()


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Begin the message of an error with ``path``; an InputError names its file already."""
    try:
        yield
    except InputError:
        raise
    except TsoError as error:
        raise TsoError(f"{path}: {error}") from None


def echo_json(document: Any) -> None:
    """Print exactly one JSON document; numbers that are not finite become null."""
    click.echo(json_text(document))


def json_text(document: Any) -> str:
    """A JSON document; numbers that are not finite become null."""
    return json.dumps(plain(document), indent=2, allow_nan=False)


def plain(value: Any) -> Any:
    """A document with nothing but what JSON has; numbers that are not finite become null."""
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if isinstance(value, Path):
        return str(value)
    if hasattr(value, "item"):  # numpy scalars
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value


def command_line() -> str:
    """The command that runs, as a line for a shell: what was given, without the defaults."""
    context = click.get_current_context()
    words = ["tso", str(context.info_name)]
    for parameter in context.command.params:
        name = parameter.name or ""
        if context.get_parameter_source(name) is not click.core.ParameterSource.COMMANDLINE:
            continue
        # --config is not a parameter of the command, but where parameters come from.
        value = context.params[name] if parameter.expose_value else context.meta[CONFIG]
        values = value if isinstance(value, tuple) else (value,)
        if isinstance(parameter, click.Argument):
            words += map(str, values)
        elif isinstance(parameter, click.Option):
            shown = max(parameter.opts, key=len)
            for one in values:
                given = "auto" if one is None else str(one)
                words += [shown] if parameter.is_flag else [shown, given]
    return shlex.join(words)


def given(ctx: click.Context) -> dict[str, Any]:
    """The parameters of a command that were not left to their defaults."""
    default = click.core.ParameterSource.DEFAULT
    return {
        name: value
        for name, value in ctx.params.items()
        if ctx.get_parameter_source(name) is not default
    }


def log(message: str) -> None:
    """One line on stderr."""
    click.echo(message, err=True)


class Warnings:
    """The warnings of a block, in order, as ``texts``; they are printed too unless ``quiet``."""

    def __init__(self, quiet: bool) -> None:
        self.quiet = quiet
        self.texts: list[str] = []

    def __enter__(self) -> Warnings:
        self._show = warnings.showwarning
        warnings.showwarning = self._keep
        return self

    def __exit__(self, *_: object) -> None:
        warnings.showwarning = self._show

    def _keep(self, message: Warning | str, *rest: Any, **named: Any) -> None:
        self.texts.append(str(message))
        if not self.quiet:
            self._show(message, *rest, **named)


class ProgressBar:
    """Progress on stderr.

    On a terminal it is a bar with the time left. Otherwise it is a line after every tenth of the
    work, and after 15 seconds. Nothing is shown in the first ``delay`` seconds.
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
