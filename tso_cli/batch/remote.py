"""Files at addresses such as s3://bucket/a.ply, by fsspec: fetched before an item, stored after."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from os.path import normpath
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


@contextmanager
def _existing(address: str) -> Iterator[tuple[Any, str]]:
    """The file system of an address, and the path there; InputError if there is no such file."""
    try:
        yield _opened(address)
    except FileNotFoundError:
        raise InputError(f"{address}: does not exist, expected a file") from None


def exists(address: str) -> bool:
    system, path = _opened(address)
    return bool(system.exists(path))


def read_remote(address: str) -> bytes:
    """The bytes of a file; InputError if it cannot be read."""
    with _existing(address) as (system, path):
        try:
            return bytes(system.cat_file(path))
        except FileNotFoundError:
            raise
        except Exception as error:  # each store has errors of its own
            raise InputError(f"{address}: cannot be read ({reason(error)})") from None


def state_of(address: str) -> str:
    """What changes if the file changes, as its file system knows it: size, time, checksum."""
    with _existing(address) as (system, path):
        return f"{address} {system.ukey(path)}"


def cameras_of(masks: Sequence[str]) -> dict[str, str]:
    """Remote mask -> the camera file next to it."""
    cameras = {}
    for mask in filter(is_remote, masks):
        folder, _, name = mask.rpartition("/")
        addresses = (f"{folder}/{camera}" for camera in names_next_to(Path(name)))
        if camera := next(filter(exists, addresses), ""):
            cameras[mask] = camera
    return cameras


@dataclass(frozen=True)
class Local:
    """The options of an item with local files in place of addresses.

    folders : name of a local folder, which no other has -> the address that it stands for.
    """

    options: dict[str, Any]
    folders: dict[str, str]

    def named(self, text: str) -> str:
        """``text`` with addresses for paths of local files, wherever they begin."""
        local_folder = re.compile(r"[\w./-]*(tso-\w+-\d+)(?=/)")
        return local_folder.sub(lambda path: self.folders.get(path[1], path[0]), text)

    def name_in(self, file: Path) -> None:
        """Let a record, or another text, name addresses for local files."""
        text = before = file.read_text(encoding="utf-8")
        if file.parent.name in self.folders:
            # A record that goes to an address: no path is relative to it any more.
            text = re.sub(r'(?<=")\.\./[^"]*', lambda path: normpath(file.parent / path[0]), text)
        if (text := self.named(text)) != before:
            with atomic_output(file) as temporary:
                temporary.write_text(text, encoding="utf-8")


@contextmanager
def local(options: Mapping[str, Any], output: str, cameras: Mapping[str, str]) -> Iterator[Local]:
    """The options of an item with local files in place of addresses.

    ``output`` is the address of the result, or "". What is written next to the local result is
    stored next to it once the block has ended without an error. ``cameras`` are as of `cameras_of`.
    Raises InputError if a file cannot be fetched, and OSError if the result cannot be stored.
    Errors of tso in the block name addresses.
    """
    with TemporaryDirectory(prefix="tso-") as folder:
        places: dict[str, str] = {}
        folders: dict[str, str] = {}
        for number, address in enumerate(dict.fromkeys(filter(is_remote, texts_of(options)))):
            place = Path(folder, f"{Path(folder).name}-{number}", PurePosixPath(address).name)
            place.parent.mkdir()
            places[address] = str(place)
            folders[place.parent.name] = address.rpartition("/")[0]
            if address != output:
                _fetch(address, place)
            if camera := cameras.get(address):
                _fetch(camera, place.with_name(PurePosixPath(camera).name))

        def placed(value: Any) -> Any:
            if isinstance(value, tuple):
                return tuple(map(placed, value))
            return places.get(value, value) if isinstance(value, str) else value

        files = Local({name: placed(value) for name, value in options.items()}, folders)
        try:
            yield files
        except TsoError as error:
            error.args = (files.named(str(error)),)
            raise
        for file in sorted(Path(places[output]).parent.iterdir()) if output else []:
            _store(file, f"{output.rpartition('/')[0]}/{file.name}")


def texts_of(options: Mapping[str, Any]) -> list[str]:
    """All texts among the options of an item, in their order."""
    values = [value if isinstance(value, tuple) else (value,) for value in options.values()]
    return [text for several in values for text in several if isinstance(text, str)]


def _fetch(address: str, place: Path) -> None:
    with _existing(address) as (system, path):
        system.get_file(path, str(place))


def _store(file: Path, address: str) -> None:
    """Store a file whole: under another name first, where names can be changed."""
    system, path = _opened(address)
    folder, _, name = path.rpartition("/")
    system.makedirs(folder, exist_ok=True)
    temporary = f"{folder}/.{name}.part"
    system.put_file(str(file), temporary)
    system.mv(temporary, path)
