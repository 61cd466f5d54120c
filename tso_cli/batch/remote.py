"""Files at addresses such as s3://bucket/a.ply, by fsspec: fetched before an item, stored after."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from os.path import normpath, relpath
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from urllib.parse import unquote

from ..errors import InputError, TsoError, needed_by
from ..io.cameras import names_next_to
from ..io.output import atomic_output, reason

MARK = "://"


def is_remote(word: object) -> bool:
    return isinstance(word, str) and MARK in word


def local_path(text: str) -> str:
    """``text`` with a path in place of an address such as file:///a%20folder/a.ply."""
    path = text.removeprefix("file://")
    return text if path == text else unquote(path.removeprefix("localhost"))


def is_on_this_machine(address: str) -> bool:
    """Whether an address, perhaps through others, is a path of this machine or lost with it."""
    return not {"file", "local", "memory"}.isdisjoint(re.split(r"://|::", address))


@contextmanager
def _opened(address: str) -> Iterator[tuple[Any, str]]:
    """The file system of an address, and the path there; InputError if there is no such file."""
    with needed_by(f"{address}: needs"):
        from fsspec.core import url_to_fs
    try:
        system, path = url_to_fs(address)
    except (ImportError, ValueError) as error:
        raise InputError(f"{address}: cannot be opened ({reason(error)})") from None
    try:
        yield system, str(path)
    except FileNotFoundError:
        raise InputError(f"{address}: does not exist, expected a file") from None


def exists(address: str) -> bool:
    with _opened(address) as (system, path):
        return bool(system.exists(path))


def read_remote(address: str) -> bytes:
    """The bytes of a file; InputError if it cannot be read."""
    try:
        with _opened(address) as (system, path):
            return bytes(system.cat_file(path))
    except TsoError:
        raise
    except Exception as error:  # each store has errors of its own
        raise InputError(f"{address}: cannot be read ({reason(error)})") from None


def state_of(address: str) -> str:
    """What changes if the file changes, as its file system knows it: size, time, checksum."""
    with _opened(address) as (system, path):
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

    Files of one remote folder lie in one local folder, under their own names.

    folders : local folder -> the address that it stands for.
    """

    options: dict[str, Any]
    folders: dict[str, str]

    def named(self, text: str, folder: Path | None = None) -> str:
        """``text`` of tso with addresses for local files, also for paths relative to ``folder``."""
        for place, address in self.folders.items():
            relative = place if folder is None else Path(relpath(place, folder)).as_posix()
            # The relative path comes first: it may end with the other.
            text = text.replace(f"{relative}/", f"{address}/").replace(f"{place}/", f"{address}/")
        return text

    def name_in(self, file: Path) -> None:
        """Let a record, or a page or camera file that tso wrote, name addresses."""
        text, folder = file.read_text(encoding="utf-8"), file.parent
        if folder.as_posix() in self.folders:
            # A record that goes to an address: no path is relative to it any more.
            whole = re.sub(r'(?<=")\.\./[^"]*', lambda path: normpath(folder / path[0]), text)
            with_addresses = self.named(whole)
        else:
            with_addresses = self.named(text, folder)
        if with_addresses != text:
            with atomic_output(file) as temporary:
                temporary.write_text(with_addresses, encoding="utf-8")


@contextmanager
def local(options: Mapping[str, Any], output: str, cameras: Mapping[str, str]) -> Iterator[Local]:
    """The options of an item with local files in place of addresses.

    ``output`` is the address of the result, or "". What is written next to the local result is
    stored next to it once the block has ended without an error. ``cameras`` are as of `cameras_of`.
    Raises InputError if a file cannot be fetched, and OSError if the result cannot be stored.
    Errors of tso in the block name addresses.
    """
    addresses = [text for text in texts_of(options) if is_remote(text) and text != output]
    addresses += cameras.values()
    with TemporaryDirectory(prefix="tso-") as root:
        places: dict[str, str] = {}
        local_folders: dict[str, Path] = {}
        for address in dict.fromkeys(addresses):
            folder, _, name = address.rpartition("/")
            local_folder = local_folders.setdefault(folder, Path(root, f"{len(local_folders)}"))
            local_folder.mkdir(exist_ok=True)
            places[address] = str(local_folder / name)
            with _opened(address) as (system, path):
                system.get_file(path, places[address])
        folders = {path.as_posix(): folder for folder, path in local_folders.items()}
        results, (folder, _, name) = Path(root, "results"), output.rpartition("/")
        results.mkdir()
        if output:
            places[output], folders[results.as_posix()] = str(results / name), folder

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
        for file in sorted(results.iterdir()):
            _store(file, f"{folder}/{file.name}")


def texts_of(options: Mapping[str, Any]) -> list[str]:
    """All texts among the options of an item, in their order."""
    values = [value if isinstance(value, tuple) else (value,) for value in options.values()]
    return [text for several in values for text in several if isinstance(text, str)]


def _store(file: Path, address: str) -> None:
    """Store a file whole: under another name first, where names can be changed."""
    with _opened(address) as (system, path):
        folder, _, name = path.rpartition("/")
        system.makedirs(folder, exist_ok=True)
        temporary = f"{folder}/.{name}.part"
        system.put_file(str(file), temporary)
        system.mv(temporary, path)
