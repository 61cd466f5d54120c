"""Records of runs: what --record writes, its key, and --config that repeats a run."""

from __future__ import annotations

import hashlib
import json
import os
import warnings
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import click

from ...errors import InputError
from ...io.reading import digest_of, plain, shown
from ...version import __version__
from ..option_files import read_options, set_defaults
from ..options import CONFIG
from .inputs import RefineInputs
from .options import RefineOptions, is_word, without_roles

SCHEMA = 1
"""Version of the form of records."""
EXPECTED = "a record of --record, or a .toml or .json file of options"
_RECORD = "tso.record"
"""Key of a context's ``meta``: the `_Record` that --config names."""


class _Record(NamedTuple):
    path: Path
    version: str
    inputs: dict[str, str]  # absolute path -> digest


def key_of(explicit: Mapping[str, Any], digests: Iterable[str]) -> str:
    """The same for two runs of one version with the same options and contents of files."""
    settings: dict[str, Any] = {}
    for name, value in sorted(without_roles(explicit, "output", "run").items()):
        values = value if isinstance(value, (tuple, list)) else (value,)
        if is_word(name, value):
            settings[name] = str(value)
        elif not any(isinstance(item, Path) for item in values):
            settings[name] = value
        elif name not in ("source", "masks"):
            settings[name] = len(values)  # which of the files it names
    text = json.dumps([__version__, settings, list(digests)], default=str)
    return hashlib.sha256(text.encode()).hexdigest()


def options_of(explicit: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """The options as a record stores them, with paths relative to its ``folder``."""

    def stored(value: Any) -> Any:
        if isinstance(value, (tuple, list)):
            return [stored(item) for item in value]
        return relative(value, folder) if isinstance(value, Path) else value

    return {
        name: str(value) if is_word(name, value) else stored(value)
        for name, value in without_roles(explicit, "run").items()
    }


def relative(path: Path, folder: Path) -> str:
    """``path`` as a record in ``folder`` names it."""
    # "..", after a link, leads out of the folder that the link names.
    place = os.path.join(os.path.realpath(path.parent), path.name)
    return Path(os.path.relpath(place, os.path.realpath(folder))).as_posix()


def read_config(ctx: click.Context, path: Path) -> None:
    """Let the options of a file stand for those that are not given.

    The file is a record, or TOML or JSON with names of options as its keys. Its paths are relative
    to its folder.
    """
    ctx.meta[CONFIG] = path
    document = read_options(path, EXPECTED)
    if "schema" in document:
        ctx.meta[_RECORD] = _record(path, document)
        document = document["options"]
    set_defaults(ctx, RefineOptions, path, document)


def _record(path: Path, document: dict[str, Any]) -> _Record:
    """The inputs and the version of a record; InputError if it is none."""
    if document["schema"] != SCHEMA:
        raise InputError(
            f"{path}: is a record of schema {shown(document['schema'])}, expected {SCHEMA}; "
            "use the version of tso that wrote it"
        )
    for key, kind in (("options", dict), ("inputs", dict), ("version", str)):
        if not isinstance(document.get(key), kind):
            fault = f"{key} is {shown(document[key])}" if key in document else f"has no {key}"
            raise InputError(f"{path}: {fault}, expected a record of --record")
    inputs = document["inputs"].items()
    digests = {os.path.realpath(path.parent / name): digest for name, digest in inputs}
    return _Record(path, document["version"], digests)


def warn_of_changes(ctx: click.Context, options: RefineOptions) -> None:
    """Warn of what differs from the run whose record --config names.

    Files that the command line names were not of that run.
    """
    record: _Record | None = ctx.meta.get(_RECORD)
    if record is None:
        return
    if record.version != __version__:
        warnings.warn(
            f"{record.path}: is of tso {plain(record.version)}, this is {__version__}; defaults "
            "may differ",
            stacklevel=2,
        )
    typed = [
        path
        for name, value in without_roles(ctx.params, "output", "run").items()
        if ctx.get_parameter_source(name) is click.core.ParameterSource.COMMANDLINE
        for path in (value if isinstance(value, tuple) else (value,))
        if isinstance(path, Path)
    ]
    files = [path for path in RefineInputs(options).files if path not in typed]
    places = set(map(os.path.realpath, files))
    digests = {os.path.realpath(path): digest_of(path) for path in files if path.exists()}
    changes = {}
    for place, digest in digests.items():
        if record.inputs.get(place, digest) != digest:
            changes[place] = "has changed since"
        # A file that was moved has its digest in the record.
        elif place not in record.inputs and digest not in record.inputs.values() and not typed:
            changes[place] = "is no input of"
    for place, digest in record.inputs.items():
        if place not in places and digest not in digests.values() and not typed:
            changes[place] = "is not read now, but is an input of"
    for place, what in changes.items():
        path = os.path.relpath(place)
        warnings.warn(f"{path}: {what} {record.path}, so the result may differ", stacklevel=2)
