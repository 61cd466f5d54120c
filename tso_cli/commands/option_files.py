"""Files of options: what the command line does not give, a file may."""

from __future__ import annotations

import json
import os
from pathlib import Path
from types import NoneType
from typing import Any

import click

from ..errors import InputError, prefixed
from ..io.output import reason
from ..io.reading import plain, read_bytes, shown
from . import options

LARGEST = 16 << 20  # bytes


def read_options(path: Path, expected: str) -> dict[str, Any]:
    """What a TOML or JSON file of options holds; InputError if it is not what is ``expected``."""
    document = _document(path, read_bytes(path, expected, LARGEST), expected)
    if not isinstance(document, dict):
        raise InputError(f"{path}: holds {shown(document)}, expected {expected}")
    return document


def set_defaults(ctx: click.Context, path: Path, values: dict[str, Any]) -> None:
    """Let the ``values`` of a file, by the names of options, stand for options not given.

    Paths are relative to the folder of the file.
    """
    parameters = {one.name: one for one in ctx.command.params if one.expose_value}
    for parameter in list(parameters.values()):
        for word in parameter.opts:
            parameters.setdefault(parameter_of(word), parameter)
    taken = {}
    for key, value in values.items():
        if isinstance(value, dict):
            raise InputError(
                f"{path}: {shown(key)} is a table, expected options such as steps = 20 at the top "
                "of the file"
            )
        name = parameter_of(key)
        if name not in parameters:
            raise InputError(
                f"{path}: {shown(key)} is no option of {ctx.command.name}, expected names such as "
                f"{_example(ctx)}"
            )
        with prefixed(f"{path}: {plain(key)} is "):
            taken[parameters[name].name] = _values(value, parameters[name], path.parent)
    ctx.default_map = {**(ctx.default_map or {}), **taken}


def _example(ctx: click.Context) -> str:
    return "camera or refine-camera" if ctx.command.name == "refine" else "seed or output"


def _values(value: Any, parameter: click.Parameter, folder: Path) -> Any:
    """A value of a file of options, as ``parameter`` takes it, with paths from ``folder``.

    Raises InputError with the value and what was expected.
    """
    several = parameter.nargs == -1 or getattr(parameter, "multiple", False)
    values = value if several and isinstance(value, list) else [value]
    for one in values:
        if not _fits(one, parameter):
            raise InputError(f"{shown(one)}, expected {_kinds(parameter.type)[1]}")
    return in_folder(values if several else value, parameter, folder)


def _fits(value: Any, parameter: click.Parameter) -> bool:
    kinds = _kinds(parameter.type)[0]
    if not isinstance(value, kinds) or (isinstance(value, bool) and bool not in kinds):
        return False
    try:
        if isinstance(value, str):
            os.fsencode(value)  # half of a character, which JSON can hold, is no text
        if value is not None:
            parameter.type.convert(value, parameter, None)
    except (click.UsageError, ValueError, OverflowError):
        return False
    return not isinstance(value, str) or "\0" not in value


def _kinds(kind: click.ParamType) -> tuple[tuple[type, ...], str]:
    """The types that a file may hold for an option, and what they mean."""
    if isinstance(kind, click.types.BoolParamType):
        return (bool,), "true or false"
    if isinstance(kind, options.AutoOrInteger):
        return (int, str, NoneType), "auto or a whole number"
    if isinstance(kind, options.Whole):
        return (int, str), f"a whole number{kind.range}"
    if isinstance(kind, click.types.FloatParamType):
        return (int, float, str), "a number"
    if isinstance(kind, click.Choice):
        return (str,), f"one of {', '.join(map(str, kind.choices))}"
    if isinstance(kind, options.FilePath):
        return (str,), "a path"
    return (int, float, str), "text"


def _document(path: Path, data: bytes, expected: str) -> Any:
    try:
        if path.suffix.lower() != ".toml":
            return json.loads(data)
        try:
            import tomllib
        except ImportError:  # Python 3.10
            import tomli as tomllib
        return tomllib.loads(data.decode())
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: cannot be read ({reason(error)}), expected {expected}") from None


def parameter_of(name: str) -> str:
    """The name of the parameter that a manifest or a file calls ``name``, as --help does."""
    special = {
        "cloud": "source", "mask": "masks", "object": "object_id", "json": "as_json",
    }  # fmt: skip
    plain = name.strip().removeprefix("--").replace("-", "_")
    return special.get(plain, plain)


def in_folder(value: Any, parameter: click.Parameter, folder: Path) -> Any:
    """``value`` with paths that are relative to ``folder``, if the parameter takes paths."""
    if isinstance(value, (list, tuple)):
        return [in_folder(one, parameter, folder) for one in value]
    kind = parameter.type
    if not isinstance(kind, options.FilePath) or not isinstance(value, str):
        return value
    return value if "://" in value or value in kind.words else str(folder / value)
