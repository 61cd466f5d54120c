"""The record of a run, from which it can be repeated, and its key, which no other run has."""

from __future__ import annotations

import hashlib
import json
import os
import warnings
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from os.path import splitext
from pathlib import Path
from types import NoneType
from typing import Any

import click

from ..errors import InputError, prefixed
from ..io.output import reason
from ..io.reading import plain, read_bytes, shown
from ..version import __version__
from . import options

SCHEMA = 1
"""Version of the form of records."""
LARGEST_CONFIG = 16 << 20  # bytes
# Options that say where results go, whether, or what is printed: they do not change a result.
WRITTEN = ("overlay", "report", "rerun", "write_camera", "write_transform")
OF_RUN = ("record", "overwrite", "check", "quiet", "verbose", "as_json")
OF_OUTPUT = ("output", "strict", *WRITTEN, *OF_RUN)


def record_of(result: str) -> str:
    """The name of a result's record."""
    return f"{splitext(result)[0]}.record.json"


_RECORD = "tso.record"
"""Key of a context's ``meta``: the `_Record` that --config names."""


@dataclass(frozen=True)
class _Record:
    path: Path
    version: str
    inputs: dict[str, str]  # absolute path -> digest


def digest_of(path: Path) -> str:
    """SHA-256 of a file; of a folder that of the names, sizes and times of its files."""
    digest = hashlib.sha256()
    try:
        if not path.is_dir():
            with path.open("rb") as stream:
                while block := stream.read(1 << 20):
                    digest.update(block)
            return digest.hexdigest()
        for file in sorted(path.rglob("*")):
            status = file.stat()
            line = f"{file.relative_to(path)} {status.st_size} {status.st_mtime_ns}"
            digest.update(line.encode(errors="surrogateescape"))
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({reason(error)})") from None
    return digest.hexdigest()


def key_of(given: Mapping[str, Any], digests: Iterable[str]) -> str:
    """What no other run has: the version, the options given, and the files' contents."""
    settings = {
        name: str(value) if _is_word(name, value) else value
        for name, value in sorted(given.items())
        if name not in OF_OUTPUT and (_is_word(name, value) or not _has_path(value))
    }  # fmt: skip
    text = json.dumps([__version__, settings, list(digests)], default=str)
    return hashlib.sha256(text.encode()).hexdigest()


def _is_word(name: str, value: Any) -> bool:
    """Whether an option has a word in place of a file."""
    return str(value) in options.WORDS.get(name, ())


def _has_path(value: Any) -> bool:
    return isinstance(value, Path) or (
        isinstance(value, (tuple, list)) and any(isinstance(one, Path) for one in value)
    )


def options_of(given: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """The options as a record stores them, with paths relative to its ``folder``."""

    def stored(value: Any) -> Any:
        if isinstance(value, (tuple, list)):
            return [stored(one) for one in value]
        return relative(value, folder) if isinstance(value, Path) else value

    return {
        name: str(value) if _is_word(name, value) else stored(value)
        for name, value in given.items()
        if name not in OF_RUN
    }


def relative(path: Path, folder: Path) -> str:
    """``path`` as a record in ``folder`` names it."""
    return Path(os.path.relpath(path, folder)).as_posix()


def read_config(ctx: click.Context, path: Path) -> None:
    """Let the options of a file stand for those that are not given.

    The file is a record, or TOML or JSON with names of options as its keys. Its paths are relative
    to its folder.
    """
    ctx.meta[options.CONFIG] = path
    expected = "a record of --record, or a .toml or .json file of options"
    document = _document(path, read_bytes(path, expected, LARGEST_CONFIG), expected)
    if not isinstance(document, dict):
        raise InputError(f"{path}: holds {shown(document)}, expected {expected}")
    if "schema" in document:
        ctx.meta[_RECORD] = _record(path, document)
        document = document["options"]
    parameters = {one.name: one for one in ctx.command.params if one.expose_value}
    found = {}
    for key, value in document.items():
        if isinstance(value, dict):
            raise InputError(
                f"{path}: {shown(key)} is a table, expected options such as steps = 20 at the top "
                "of the file"
            )
        name = parameter_of(key)
        if name not in parameters:
            raise InputError(
                f"{path}: {shown(key)} is no option of {ctx.command.name}, expected names such as "
                "camera or refine-camera"
            )
        with prefixed(f"{path}: {plain(key)} is "):
            found[name] = _values(value, parameters[name], path.parent)
    ctx.default_map = {**(ctx.default_map or {}), **found}


def _record(path: Path, document: dict[str, Any]) -> _Record:
    """The inputs and the version of a record; InputError if it is none."""
    if document["schema"] != SCHEMA:
        raise InputError(
            f"{path}: is a record of schema {shown(document['schema'])}, expected {SCHEMA}; "
            "use the version of tso that wrote it"
        )
    for key, kind in (("options", dict), ("inputs", dict), ("version", str)):
        if not isinstance(document.get(key), kind):
            found = f"{key} is {shown(document[key])}" if key in document else f"has no {key}"
            raise InputError(f"{path}: {found}, expected a record of --record")
    inputs = document["inputs"]
    for name, digest in inputs.items():
        if not isinstance(digest, str):
            raise InputError(
                f"{path}: the hash of {plain(name)} is {shown(digest)}, expected SHA-256 in hex"
            )
    placed = {os.path.abspath(path.parent / name): digest for name, digest in inputs.items()}
    return _Record(path, document["version"], placed)


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


def warn_of_changes(ctx: click.Context) -> None:
    """Warn of what differs from the run whose record --config names.

    Files that the command line names were not of that run.
    """
    record = ctx.meta.get(_RECORD)
    if not isinstance(record, _Record):
        return
    if record.version != __version__:
        warnings.warn(
            f"{record.path}: is of tso {plain(record.version)}, this is {__version__}; defaults "
            "may differ",
            stacklevel=2,
        )
    for place, what in _changes(ctx, record):
        path = os.path.relpath(place)
        warnings.warn(f"{path}: {what} {record.path}, so the result may differ", stacklevel=2)


def _changes(ctx: click.Context, record: _Record) -> Iterator[tuple[str, str]]:
    """Each file that differs from the record, by its absolute path, and in what."""
    from .refine_files import RefineInputs

    inputs = options.pick(RefineInputs, ctx.params)
    typed = list(_typed(ctx, inputs))
    read = {os.path.abspath(path): path for path in inputs.files if path not in typed}
    digests = {place: digest_of(path) for place, path in read.items() if path.exists()}
    for place, digest in digests.items():
        if record.inputs.get(place, digest) != digest:
            yield place, "has changed since"
        # A file that was moved has its digest in the record.
        elif place not in record.inputs and digest not in record.inputs.values() and not typed:
            yield place, "is no input of"
    for place, digest in record.inputs.items():
        if place not in read and digest not in digests.values() and not typed:
            yield place, "is not read now, but is an input of"


def _typed(ctx: click.Context, inputs: Any) -> Iterator[Path]:
    """The input files that are given on the command line."""
    for name, value in vars(inputs).items():
        if ctx.get_parameter_source(name) is click.core.ParameterSource.COMMANDLINE:
            values = value if isinstance(value, tuple) else (value,)
            yield from (one for one in values if isinstance(one, Path))


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
