"""The record of a run, from which it can be repeated, and its key, which no other run has."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import click

from ..errors import InputError
from ..io.output import reason
from ..io.reading import read_bytes, shown
from ..version import __version__
from . import options

SCHEMA = 1
"""Version of the form of records."""
LARGEST_CONFIG = 16 << 20  # bytes
# Options that say where results go, whether, or what is printed: they do not change a result.
WRITTEN = ("overlay", "report", "rerun", "write_camera")
OF_RUN = ("record", "overwrite", "check", "quiet", "verbose", "as_json")
OF_OUTPUT = ("output", "strict", *WRITTEN, *OF_RUN)


def record_of(output: Path) -> Path:
    """Where the record of a result is."""
    return output.with_name(f"{output.stem}.record.json")


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
        name: value for name, value in sorted(given.items())
        if name not in OF_OUTPUT and not _has_path(value)
    }  # fmt: skip
    text = json.dumps([__version__, settings, list(digests)], default=str)
    return hashlib.sha256(text.encode()).hexdigest()


def _has_path(value: Any) -> bool:
    return isinstance(value, Path) or (
        isinstance(value, (tuple, list)) and any(isinstance(one, Path) for one in value)
    )


def options_of(given: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """The options as a record stores them, with paths relative to its ``folder``."""

    def stored(value: Any) -> Any:
        if isinstance(value, (tuple, list)):
            return [stored(one) for one in value]
        if not isinstance(value, Path) or value == options.FIT:
            return str(value) if isinstance(value, Path) else value
        return Path(os.path.relpath(value, folder)).as_posix()

    return {name: stored(value) for name, value in given.items() if name not in OF_RUN}


def read_config(ctx: click.Context, path: Path) -> None:
    """Let the options of a file stand for those that are not given.

    The file is a record, or TOML or JSON with names of options as its keys. Its paths are relative
    to its folder.
    """
    command = ctx.command
    ctx.meta[options.CONFIG] = path
    expected = "a record of --record, or a .toml or .json file of options"
    document = _document(path, read_bytes(path, expected, LARGEST_CONFIG), expected)
    if not isinstance(document, dict):
        raise InputError(f"{path}: holds {shown(document)}, expected {expected}")
    if "schema" in document:
        if document["schema"] != SCHEMA:
            raise InputError(
                f"{path}: is a record of schema {shown(document['schema'])}, expected {SCHEMA}; "
                "use the version of tso that wrote it"
            )
        document = document.get("options")
        if not isinstance(document, dict):
            raise InputError(f"{path}: has no options, expected a record of --record")
    parameters = {parameter.name: parameter for parameter in command.params}
    found = {}
    for key, value in document.items():
        name = parameter_of(key)
        if name not in parameters or name == "config":
            raise InputError(
                f"{path}: {shown(key)} is no option of {command.name}, expected names such as "
                "camera or refine-camera"
            )
        found[name] = in_folder(value, parameters[name], path.parent)
    ctx.default_map = {**(ctx.default_map or {}), **found}


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
    is_path = isinstance(parameter.type, options.FilePath) and isinstance(value, str)
    if not is_path or "://" in value or Path(value) in (options.FIT, Path("default")):
        return value
    return str(folder / value)
