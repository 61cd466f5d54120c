"""Files at addresses such as s3://bucket/a.ply, by fsspec: fetched before an item, stored after."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from typing import Any

from ..errors import InputError, TsoError, needed_by
from ..io.cameras import names_next_to
from ..io.output import atomic_output, reason

MARK = "://"


def is_remote(word: object) -> bool:
    return isinstance(word, str) and MARK in word


def _opened(address: str) -> tuple[Any, str]:
    """The file system of an address, and the path there."""
    with needed_by(f"{address}: needs"):
        from fsspec.core import url_to_fs
    try:
        system, path = url_to_fs(address)
    except (ImportError, ValueError) as error:
        raise InputError(f"{address}: cannot be opened ({reason(error)})") from None
    return system, str(path)


def exists(address: str) -> bool:
    system, path = _opened(address)
    return bool(system.exists(path))


def read_remote(address: str) -> bytes:
    """The bytes of a file; InputError if it cannot be read."""
    system, path = _opened(address)
    try:
        return bytes(system.cat_file(path))
    except FileNotFoundError:
        raise InputError(f"{address}: does not exist, expected a file") from None
    except Exception as error:  # each store has errors of its own
        raise InputError(f"{address}: cannot be read ({reason(error)})") from None


def state_of(address: str) -> str:
    """What changes if the file changes, as its file system knows it: size, time, checksum."""
    system, path = _opened(address)
    try:
        return f"{address} {system.ukey(path)}"
    except FileNotFoundError:
        raise InputError(f"{address}: does not exist, expected a file") from None


def cameras_of(masks: Sequence[str]) -> dict[str, str]:
    """Remote mask -> the camera file next to it."""
    found = {}
    for mask in filter(is_remote, masks):
        folder, _, name = mask.rpartition("/")
        addresses = (f"{folder}/{one}" for one in names_next_to(Path(name)))
        camera = next(filter(exists, addresses), None)
        if camera is not None:
            found[mask] = camera
    return found


@dataclass(frozen=True)
class Local:
    """The options of an item with local files in place of addresses.

    folders : folder of a local file -> that of its address. Names are the same in both.
    """

    given: dict[str, Any]
    folders: dict[str, str]

    def named(self, text: str, folder: Path | None = None) -> str:
        """``text`` with addresses for local files, also for paths relative to ``folder``."""
        for place, address in self.folders.items():
            relative = place if folder is None else Path(os.path.relpath(place, folder)).as_posix()
            # The relative path comes first: it may end with the other. "." is in any path.
            for found in (relative, place) if relative != "." else (place,):
                text = text.replace(f"{found}/", f"{address}/")
        return text

    def name_in(self, file: Path) -> None:
        """Let a record, or another text, name addresses for local files."""
        if not self.folders:
            return
        before = file.read_text(encoding="utf-8")
        text = self.named(before, file.parent)
        if file.parent.as_posix() in self.folders and file.suffix == ".json":
            # The record goes to its address: no path is relative to it any more.
            document = json.loads(text)
            document["options"] = _whole(document["options"], file.parent)
            text = json.dumps(document, indent=2) + "\n"
        if text != before:
            with atomic_output(file) as temporary:
                temporary.write_text(text, encoding="utf-8")


def _whole(value: Any, folder: Path) -> Any:
    """``value`` with whole paths for those that lead out of ``folder``."""
    if isinstance(value, dict):
        return {name: _whole(one, folder) for name, one in value.items()}
    if isinstance(value, list):
        return [_whole(one, folder) for one in value]
    leads_out = isinstance(value, str) and value.startswith("../")
    return os.path.normpath(folder / value) if leads_out else value


@contextmanager
def local(given: Mapping[str, Any], output: str, cameras: Mapping[str, str]) -> Iterator[Local]:
    """The options of an item with local files in place of addresses.

    ``output`` is the address of the result, or "". What is written next to the local result is
    stored next to it once the block has ended without an error. ``cameras`` are as of `cameras_of`.
    Raises InputError if a file cannot be fetched, and OSError if the result cannot be stored.
    Errors of tso in the block name addresses.
    """
    addresses = list(filter(is_remote, texts_of(given)))
    if not addresses:
        yield Local(dict(given), {})
        return
    with TemporaryDirectory(prefix="tso-") as folder:
        places: dict[str, str] = {}
        folders: dict[str, str] = {}
        for number, address in enumerate(dict.fromkeys(addresses)):
            # No other folder has this name, so `named` may look for it alone.
            place = Path(folder, f"{Path(folder).name}-{number}", PurePosixPath(address).name)
            place.parent.mkdir()
            places[address] = str(place)
            folders[place.parent.as_posix()] = address.rpartition("/")[0]
            if address == output:
                continue
            _fetch(address, place)
            if address in cameras:
                _fetch(cameras[address], place.with_name(PurePosixPath(cameras[address]).name))

        def placed(value: Any) -> Any:
            if isinstance(value, tuple):
                return tuple(map(placed, value))
            return places.get(value, value) if isinstance(value, str) else value

        fetched = Local({name: placed(value) for name, value in given.items()}, folders)
        try:
            yield fetched
        except TsoError as error:
            error.args = (fetched.named(str(error)),)
            raise
        for file in sorted(Path(places[output]).parent.iterdir()) if output else []:
            _store(file, f"{output.rpartition('/')[0]}/{file.name}")


def texts_of(given: Mapping[str, Any]) -> list[str]:
    """All texts among the options of an item, in their order."""
    values = [value if isinstance(value, tuple) else (value,) for value in given.values()]
    return [text for several in values for text in several if isinstance(text, str)]


def _fetch(address: str, place: Path) -> None:
    system, path = _opened(address)
    try:
        system.get_file(path, str(place))
    except FileNotFoundError:
        raise InputError(f"{address}: does not exist, expected a file") from None


def _store(file: Path, address: str) -> None:
    """Store a file whole: under another name first, where names can be changed."""
    system, path = _opened(address)
    parent, _, name = path.rpartition("/")
    system.makedirs(parent, exist_ok=True)
    temporary = f"{parent}/.{name}.part"
    system.put_file(str(file), temporary)
    system.mv(temporary, path)
