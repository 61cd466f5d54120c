"""Files at addresses such as s3://bucket/a.ply, by fsspec: fetched before an item, stored after."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from typing import Any

from ..errors import InputError
from ..io.output import reason

MARK = "://"


def is_remote(word: object) -> bool:
    return isinstance(word, str) and MARK in word


def _opened(address: str) -> tuple[Any, str]:
    """The file system of an address, and the path there."""
    try:
        from fsspec.core import url_to_fs
    except ImportError:
        raise InputError(
            f"{address}: needs fsspec, which is not installed: pip install 'tso-cli[remote]'"
        ) from None
    try:
        system, path = url_to_fs(address)
    except (ImportError, ValueError) as error:
        raise InputError(f"{address}: cannot be opened ({reason(error)})") from None
    return system, str(path)


def exists(address: str) -> bool:
    system, path = _opened(address)
    return bool(system.exists(path))


def state_of(address: str) -> str:
    """What changes if the file changes, as its file system knows it: size, time, checksum."""
    system, path = _opened(address)
    try:
        return f"{address} {system.ukey(path)}"
    except FileNotFoundError:
        raise InputError(f"{address}: does not exist, expected a file") from None


@contextmanager
def local(words: Sequence[str], output: str) -> Iterator[list[str]]:
    """The arguments of an item with local files in place of addresses.

    ``output`` is the address of the result, or "". What is written next to the local result is
    stored next to it once the block has ended without an error. Raises InputError if a file cannot
    be fetched, and OSError if the result cannot be stored.
    """
    if not output and not any(is_remote(word) for word in words):
        yield list(words)
        return
    with TemporaryDirectory(prefix="tso-") as folder:
        found: list[str] = []
        results: Path | None = None
        for number, word in enumerate(words):
            if not is_remote(word):
                found.append(word)
                continue
            place = Path(folder, str(number), PurePosixPath(word).name)
            place.parent.mkdir()
            found.append(str(place))
            if word == output:
                results = place.parent
            else:
                _fetch(word, place)
        yield found
        for file in sorted(results.iterdir()) if results else []:
            _store(file, f"{output.rpartition('/')[0]}/{file.name}")


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
