"""Options in files: TOML, JSON, records, and the rows of a manifest."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import Any

import click

from ..errors import InputError, prefixed
from ..io.output import reason
from ..io.reading import plain, read_bytes, shown
from ..option import AUTO, Declared, declared

LARGEST = 16 << 20  # bytes
SWITCHES = {"true": True, "1": True, "yes": True, "false": False, "0": False, "no": False}


def read_options(path: Path, expected: str) -> dict[str, Any]:
    """What a TOML or JSON file of options holds; InputError if it is not what is ``expected``."""
    data = read_bytes(path, expected, LARGEST)
    try:
        if path.suffix.lower() != ".toml":
            document = json.loads(data, object_pairs_hook=_without_repeats)
        else:
            try:
                import tomllib
            except ImportError:  # Python 3.10
                import tomli as tomllib
            document = tomllib.loads(data.decode())
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: cannot be read ({reason(error)}), expected {expected}") from None
    if not isinstance(document, dict):
        raise InputError(f"{path}: holds {shown(document)}, expected {expected}")
    return document


def set_defaults(ctx: click.Context, kind: type, path: Path, values: dict[str, Any]) -> None:
    """Let the ``values`` of a file stand for the options of ``kind`` that are not given."""
    options = values_of(kind, str(ctx.command.name), path, values)
    ctx.default_map = {**(ctx.default_map or {}), **options}


def values_of(kind: type, command: str, path: Path, values: dict[str, Any]) -> dict[str, Any]:
    """The ``values`` of a file, by the fields of ``kind``, the options of a command.

    Paths are text, relative to the folder of the file.
    """

    def placed(text: str) -> str:
        return text if "://" in text else str(path.parent / text)

    table, options = named(kind), {}
    example = "camera or refine-camera" if command == "refine" else "seed or output"
    for key, value in values.items():
        if isinstance(value, dict):
            raise InputError(
                f"{path}: {shown(key)} is a table, expected options such as steps = 20 at the top "
                "of the file"
            )
        if (entry := table.get(plain_name(key))) is None:
            raise InputError(
                f"{path}: {shown(key)} is no option of {command}, expected names such as {example}"
            )
        if entry.name in options:
            raise InputError(f"{path}: {plain(key)} is there twice, expected it once")
        with prefixed(f"{path}: {plain(key)} is "):
            options[entry.name] = value_of(entry, value, placed)
    return options


def _without_repeats(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """A JSON object; ValueError if it has a key twice."""
    document = dict(pairs)
    if len(document) < len(pairs):
        names = [name for name, _ in pairs]
        raise ValueError(f"{plain(next(n for n in names if names.count(n) > 1))} is there twice")
    return document


def plain_name(name: str) -> str:
    """The name of an option as `named` has it: refine_camera for --refine-camera."""
    return name.strip().removeprefix("--").replace("-", "_")


@lru_cache
def named(kind: Any) -> dict[str, Declared]:
    """The options of a dataclass by the names of their fields, and by those that help shows."""
    table = dict(declared(kind))
    for entry in declared(kind).values():
        table |= {plain_name(name): entry for name in entry.flags if name[:2] == "--"}
    return table


def value_of(entry: Declared, value: Any, place: Callable[[str], str]) -> Any:
    """The value of an option that a file has as ``value``, which may be text.

    ``place`` says where a path of the file leads. InputError with the value and what was expected.
    """
    if entry.length > 1 and (not isinstance(value, list) or len(value) != entry.length):
        raise InputError(f"{shown(value)}, expected {entry.length} numbers")
    several = entry.several or entry.length > 1
    is_sequence = several and isinstance(value, (list, tuple))
    values = [_single(entry, item, place) for item in (value if is_sequence else [value])]
    return tuple(values) if several else values[0]


def _single(entry: Declared, value: Any, place: Callable[[str], str]) -> Any:
    option, text = entry.option, isinstance(value, str)
    auto = AUTO in option.words
    if entry.optional and (value is None or (auto and value == AUTO)):
        return None
    if option.table is not None and value == "list":
        raise InputError("list, expected a name from that list")
    try:
        if option.parser is not None:
            return option.parser.convert(value, None, None)
        if entry.plain is bool and (text or isinstance(value, bool)):
            return SWITCHES[value.casefold()] if text else value
        if entry.plain in (int, float) and isinstance(value, (int, float, str)):
            number = value
            if entry.plain is int and not isinstance(value, bool):
                number = _whole(value)
            elif text or (entry.plain is float and not isinstance(value, bool)):
                number = float(value)
            if entry._replace(length=1).takes(number):
                return number
        if entry.plain is Path and text and value and _is_text(value):
            return value if value in option.words else place(value)
        words = isinstance(value, (int, float, str)) and not isinstance(value, bool)
        if entry.plain is str and words and _is_text(str(value)) and entry.takes(str(value)):
            return str(value)
    except click.UsageError as error:
        raise InputError(f"{shown(value)}, {error.format_message()}") from None
    except (KeyError, ValueError, OverflowError):
        pass
    raise InputError(f"{shown(value)}, expected {'auto or ' if auto else ''}{entry.expected}")


def _whole(value: float | str) -> float:
    """A whole number, which tables may have as 5.0; others stay as they are."""
    with suppress(ValueError):
        if isinstance(value, str):
            return int(value)
    number = float(value)
    return int(number) if number.is_integer() else number


def _is_text(text: str) -> bool:
    """Whether a text can be the name of a file: JSON can hold halves of characters."""
    os.fsencode(text)
    return "\0" not in text
