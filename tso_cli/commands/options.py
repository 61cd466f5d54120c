"""What several commands share: groups, options, help, tables, progress, warnings and JSON."""

from __future__ import annotations

import gc
import json
import math
import os
import re
import shlex
import sys
import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import MISSING, fields
from importlib import import_module
from pathlib import Path
from typing import Any, TypeVar

import click

from ..errors import InputError, TsoError
from ..io.output import require_output as require_output
from ..option import AUTO, Declared, declared, opt

T = TypeVar("T")
CONTEXT: dict[str, Any] = {"help_option_names": ["-h", "--help"], "max_content_width": 100}
"""Settings of the context of every command."""
SHOW_ALL = "tso.show_all"
"""Key of a context's ``meta``: whether the help shows every option."""
CONFIG = "tso.config"
"""Key of a context's ``meta``: the file of --config."""
REQUIRED, INFINITY = MISSING, math.inf


class FilePath(click.Path):
    """A path as `pathlib.Path`; the readers check it, so their messages are the same everywhere.

    words : that stand in place of a file. A file of that name, written ./fit, becomes absolute.
    """

    def __init__(self, *words: str) -> None:
        super().__init__(path_type=Path)
        self.words = words

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if value == "":
            self.fail("is empty, expected a path", param, ctx)
        path = Path(str(super().convert(value, param, ctx)))
        return path.absolute() if str(path) in self.words and str(value) != str(path) else path


PATH = FilePath()


class AutoOrInteger(click.types.IntParamType):
    """A whole number, or None for auto."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        return None if value == "auto" else super().convert(value, param, ctx)


class LazyGroup(click.Group):
    """Commands that are imported when they are run, so that `tso --help` does not wait for torch.

    Without a command the group prints its help on stderr and exits with 2.

    sections : heading -> name of a command -> (its module, its line of help). The module holds the
        command as ``command``.
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
        width = max(map(len, self._modules))
        for heading, commands in self.sections.items():
            with formatter.section(heading):
                formatter.write_dl([(n.ljust(width), line) for n, (_, line) in commands.items()])


class Command(click.Command):
    """A command whose help shows defaults, and options under headings.

    headings : name of a parameter -> the heading above it and above the parameters after it that
        have none. Parameters of one heading stand together.
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


def command(
    name: str, kind: type[T], *more: click.Option
) -> Callable[[Callable[[click.Context, T], None]], Command]:
    """A decorator: the command whose options are those of ``kind``, and ``more``.

    The function gets them as a ``kind``, which has checked them.
    """
    table = declared(kind)  # type: ignore[arg-type]
    headings = {name: e.option.heading for name, e in table.items() if e.option.heading}
    brief = [name for name, entry in table.items() if entry.option.brief]

    def decorate(function: Callable[[click.Context, T], None]) -> Command:
        def callback(**values: Any) -> None:
            for name, value in list(values.items()):
                if value is None and not table[name].optional:
                    del values[name]
            function(click.get_current_context(), kind(**values))

        callback.__doc__ = function.__doc__
        flags = {entry.title: entry.flag for entry in table.values()}
        parameters = [*(_parameter(entry, flags) for entry in table.values()), *more]
        return Command(
            name, callback=callback, help=function.__doc__, params=parameters, headings=headings,
            brief=brief if len(brief) < len(table) else (),
        )  # fmt: skip

    return decorate


def parameter(entry: Declared) -> click.Parameter:
    """An option of no dataclass as click has it, which checks its value."""

    def checked(ctx: click.Context, parameter: click.Parameter, value: Any) -> Any:
        for item in value if entry.several else (value,):
            if item is not None and not entry.takes(item):
                raise InputError(f"{entry.flag} is {item}, expected {entry.expected}")
        return value

    option = _parameter(entry, {})
    option.callback = checked
    return option


def _parameter(entry: Declared, flags: Mapping[str, str]) -> click.Parameter:
    """An option of a dataclass as click has it."""
    option = entry.option
    if option.role == "argument":
        return click.Argument(
            [entry.name], type=_click_type(entry), nargs=-1 if entry.several else 1,
            required=entry.required, metavar=option.metavar,
        )  # fmt: skip
    words = f"  [default: {option.default_words}]" if option.default_words else ""
    help = _with_flags(option.help + words, flags)
    settings: dict[str, Any] = dict(help=help, metavar=option.metavar)
    if entry.plain is bool:
        settings |= dict(is_flag=True)
    else:
        settings |= dict(type=_click_type(entry), multiple=entry.several, required=entry.required)
        settings |= dict(nargs=entry.length)
        if not entry.required and entry.default not in (None, ()) and not option.default_words:
            settings |= dict(default=entry.default)
    if option.table is not None:
        settings |= dict(callback=listing(option.table), is_eager=True)
    return click.Option([*entry.flags, entry.name], **settings)


def _with_flags(text: str, flags: Mapping[str, str]) -> str:
    """A help in which names of options in backquotes are as on the command line."""
    return re.sub(r"`(\w+)`", lambda name: flags.get(name[1], name[0]), text)


class _Parsed(click.ParamType):
    """A value that a parser of its own reads; the parser need not know click."""

    def __init__(self, parser: Any) -> None:
        self.parser, self.name = parser, parser.name

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        # A file of options has read it already.
        return value if isinstance(value, tuple) else self.parser.convert(value, param, ctx)


def _click_type(entry: Declared) -> Any:
    if entry.choices:
        return click.Choice(entry.choices)
    if entry.option.parser is not None:
        return _Parsed(entry.option.parser)
    if entry.plain is Path:
        return FilePath(*entry.option.words)
    return AutoOrInteger() if AUTO in entry.option.words else entry.plain


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

    def show_all(ctx: click.Context, parameter: click.Parameter, value: bool) -> None:
        if value and not ctx.resilient_parsing:
            ctx.meta[SHOW_ALL] = True
            click.echo(ctx.get_help())
            ctx.exit()

    # Where --help shows every option, it is hidden.
    help_all = click.Option(
        ["--help-all"], is_flag=True, is_eager=True, expose_value=False, callback=show_all,
        hidden=not getattr(command, "brief", ()), help="Show every option and exit.",
    )  # fmt: skip
    command.params.append(help_all)
    return command


def listing(table: Callable[[], Mapping[str, str]]) -> Callable[..., Any]:
    """The callback of an option that takes the word `list`: print ``table()`` and exit with 0.

    The table is name -> meaning; it is made only then. The option has to be eager, so that
    `tso COMMAND --option list` needs no arguments.
    """

    def print_if_asked(ctx: click.Context, parameter: click.Parameter, value: Any) -> Any:
        is_list = value == "list" or (isinstance(value, tuple) and "list" in value)
        if is_list and not ctx.resilient_parsing:
            rows = table()
            width = max(map(len, rows), default=0)
            for name, words in rows.items():
                click.echo(f"{name:{width}}  {words}".rstrip())
            ctx.exit()
        return value

    return print_if_asked


def overwrite() -> Any:
    return opt(False, help="Replace outputs that exist.", brief=True, role="run")


def as_json() -> Any:
    help = "Print one JSON document on stdout."
    return opt(False, help=help, brief=True, role="run", names=("json",))


def quiet(help: str = "Print nothing but errors.") -> Any:
    return opt(False, help=help, role="run", names=("-q", "quiet"))


def seed() -> Any:
    return opt(0, help="Seed of all random numbers.", least=0, most=2**63 - 1)


def device() -> Any:
    help = "cpu, cuda, cuda:1, mps or auto. GPU support (Triton kernels) is experimental."
    return opt("cpu", help=help, metavar="DEVICE")


def _formats() -> dict[str, str]:
    """The table that `--camera-format list` prints."""
    from ..io.cameras import FORMATS

    return {name: words for name, (words, _) in FORMATS.items()}


def camera_format() -> Any:
    help = "Format of the camera file, if the content does not tell; `list` lists all."
    return opt(None, help=help, metavar="NAME", table=_formats)


def object_id() -> Any:
    help = "Object of a BOP scene that has several."
    return opt(None, help=help, least=0, metavar="ID", names=("object",))


def label() -> Any:
    help = "Label of the object in masks that show several: a number, R,G,B, or a name."
    return opt(None, help=help, metavar="N")


def mask_index() -> Any:
    help = "Place of the object's mask in an array or list of several masks."
    return opt(None, help=help, least=0, metavar="N")


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
    return json.dumps(json_values(document), indent=2, allow_nan=False)


def json_values(value: Any) -> Any:
    """A document with nothing but what JSON has; numbers that are not finite become null."""
    if isinstance(value, dict):
        return {str(key): json_values(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [json_values(item) for item in value]
    if isinstance(value, Path):
        return str(value)
    if hasattr(value, "item"):  # numpy scalars
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value


def command_line(name: str, kind: Any, values: Mapping[str, Any], *more: str) -> str:
    """A command with the ``values`` of its options and ``more`` words, as a line for a shell."""
    arguments, words = [], []
    for entry in declared(kind).values():
        if entry.name not in values:
            continue
        value = values[entry.name]
        items = value if entry.several else (value,)
        texts = [AUTO if item is None else str(item) for item in items]
        if entry.option.role == "argument":
            arguments += texts
        elif entry.plain is bool:
            words += [entry.flag]
        else:
            words += [word for text in texts for word in (entry.flag, text)]
    return shlex.join(["tso", name, *arguments, *words, *more])


def explicit_options(ctx: click.Context, *without: click.core.ParameterSource) -> dict[str, Any]:
    """The parameters of a command whose values come neither from defaults nor ``without``."""
    sources = (click.core.ParameterSource.DEFAULT, *without)
    values = ctx.params.items()
    return {name: v for name, v in values if ctx.get_parameter_source(name) not in sources}


def log(message: str) -> None:
    """One line on stderr."""
    click.echo(message, err=True)


class Warnings:
    """The warnings of a block, in order, as ``texts``; they are printed too unless ``quiet``."""

    def __init__(self, quiet: bool) -> None:
        self.quiet = quiet
        self.texts: list[str] = []

    def __enter__(self) -> Warnings:
        self._block = warnings.catch_warnings()
        self._block.__enter__()
        warnings.simplefilter("always", UserWarning)  # else a process says it of its first item
        self._show, warnings.showwarning = warnings.showwarning, self._keep
        return self

    def __exit__(self, *error: Any) -> None:
        self._block.__exit__(*error)

    def _keep(self, message: Warning | str, *rest: Any, **more: Any) -> None:
        self.texts.append(str(message))
        if not self.quiet:
            self._show(message, *rest, **more)


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
        self._first = begun, done_before = self._first or (now, done)
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
        try:
            columns = os.get_terminal_size(sys.stderr.fileno()).columns or 80
        except OSError:
            columns = 80
        # A line that wraps cannot be overwritten: shorten the bar until it fits.
        width = min(40, columns - len(f"{self.label} [] {total}/{total} {note}, 00:00 left") - 1)
        if done_before < done < total:
            seconds = math.ceil((now - begun) / (done - done_before) * (total - done))
            words += f", {seconds // 60}:{seconds % 60:02} left"
        filled = done * width // max(total, 1)
        bar = f"[{'#' * filled}{'.' * (width - filled)}] " if width > 0 else ""
        self._open = done != total
        click.echo(f"\r{self.label} {bar}{words}\x1b[K", err=True, nl=not self._open)

    def close(self) -> None:
        """End the line of a bar that stopped early."""
        if self._open:
            log("")
        self._open = False
