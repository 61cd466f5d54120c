"""The bytes, JSON document, array (.npy) or table of an input file, or one clear line why not. Nothing is unpickled."""

from __future__ import annotations

import io
import json
import math
import stat
import warnings
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from .output import reason

Integers = NDArray[np.int64]
_LONGEST = 100  # characters of a number
_BLANK = np.isin(np.arange(256), list(b"\t\n\v\f\r "))
_READERS = {
    (1, 0): np.lib.format.read_array_header_1_0,
    (2, 0): np.lib.format.read_array_header_2_0,
}


def read_bytes(path: Path, expected: str, limit: int | None = None, most: int = -1) -> bytes:
    """The bytes of the regular file ``path``, or the first ``most`` of them.

    Raises InputError, naming what is ``expected``, if it is missing, none, unreadable, empty or larger than ``limit`` bytes.
    """
    try:
        about = path.stat()
        if stat.S_ISDIR(about.st_mode):
            raise InputError(f"{path}: is a folder, expected {expected}")
        if not stat.S_ISREG(about.st_mode):
            raise InputError(f"{path}: is not a regular file, expected {expected}")
        if about.st_size == 0:
            raise InputError(f"{path}: is empty, expected {expected}")
        if limit is not None and about.st_size > limit:
            raise InputError(
                f"{path}: holds {about.st_size:,} bytes, expected {expected} of at most {limit:,}"
            )
        if most < 0:
            require_memory(path, 2 * about.st_size)
        with path.open("rb") as stream:
            return stream.read(most)
    except (FileNotFoundError, NotADirectoryError):
        raise InputError(f"{path}: does not exist, expected {expected}") from None
    except MemoryError:
        raise InputError(f"{path}: does not fit into memory") from None
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read ({reason(error)}), expected {expected}") from None


def require_memory(path: Path, needed: int) -> None:
    """InputError unless so many bytes of memory are free for what is in ``path``."""
    if needed > (free := free_memory()):
        found = f"needs about {needed / 2**30:.2g} GiB of memory"
        raise InputError(f"{path}: {found}, expected at most the {free / 2**30:.2g} that are free")


def free_memory() -> float:
    """Bytes of memory that are free on this machine and, in a container, left to it; infinite where nothing tells."""
    free = math.inf
    with suppress(OSError, ValueError, IndexError):
        free = 1024.0 * int(
            Path("/proc/meminfo").read_text().partition("MemAvailable:")[2].split()[0]
        )
        group = Path("/sys/fs/cgroup")
        left = int((group / "memory.max").read_text()) - int((group / "memory.current").read_text())
        free = min(free, left)
    return free


def read_json(
    path: Path,
    expected: str,
    form: str,
    limit: int | None = None,
    build: Callable[[list[tuple[str, Any]]], Any] = dict,
) -> Any:
    """The JSON document in ``path``, its objects made by ``build``; InputError as `read_bytes`, or if it is not JSON."""
    try:
        return json.loads(read_bytes(path, expected, limit), object_pairs_hook=build)
    except RecursionError:
        raise InputError(f"{path}: is not JSON (nested too deep), expected {form}") from None
    except ValueError as error:
        raise InputError(f"{path}: is not JSON ({reason(error)}), expected {form}") from None


def shown(value: object) -> str:
    """``value`` as a message may quote it: one printable line of at most 60 characters."""
    try:
        text = ascii(value)
    except (RecursionError, ValueError):
        text = f"a {type(value).__name__}"
    return text if len(text) <= 60 else text[:57] + "..."


def read_array(
    data: bytes, path: Path, kinds: str = "biufc", expected: str = "numbers"
) -> NDArray[Any]:
    """The read-only array in the bytes of a .npy file, its type one of numpy's ``kinds``, which messages call ``expected``.

    Raises InputError if it is no such file, or is shorter or longer than its header says.
    """
    dtype, shape, fortran, begin = array_header(data, path)
    if dtype.kind not in kinds:
        raise InputError(f"{path}: holds values of type {shown(str(dtype))}, expected {expected}")
    size = math.prod(shape) * dtype.itemsize
    if any(not isinstance(n, int) or n < 0 for n in shape) or size != len(data) - begin:
        raise InputError(
            f"{path}: has {len(data) - begin:,} bytes of values, expected {shown(shape)} of {dtype}"
        )
    try:
        array = np.frombuffer(data, dtype=dtype, count=math.prod(shape), offset=begin)
        return array.reshape(shape, order="F" if fortran else "C")
    except (ValueError, TypeError) as error:
        raise InputError(f"{path}: is not a readable .npy file ({reason(error)})") from None


def array_header(data: bytes, path: Path) -> tuple[np.dtype[Any], tuple[int, ...], bool, int]:
    """Of a .npy file type, shape, order (whether Fortran's) and the byte where values begin; InputError where it is none."""
    stream = io.BytesIO(data)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            version = np.lib.format.read_magic(stream)
            if version not in _READERS:
                raise ValueError(f"version {version[0]}.{version[1]}, expected 1.0 or 2.0")
            shape, fortran, dtype = _READERS[version](stream)
    # numpy evaluates the header as a Python literal, so that a damaged one can raise nearly anything.
    except Exception as error:
        raise InputError(f"{path}: is not a readable .npy file ({reason(error)})") from None
    return dtype, shape, fortran, stream.tell()


class TextTable:
    """The words of ``data[offset:]``, spanning bytes ``starts`` to ``ends`` [T], and the lines they stand in.

    ``first``, ``counts``, ``numbers`` [L]: of each line that is not blank the index of its first word, its words, its number.
    """

    def __init__(self, data: bytes, path: Path, offset: int = 0, lines_before: int = 0) -> None:
        self.data, self.path = data, path
        body = np.frombuffer(data, np.uint8, offset=offset)
        edges = np.flatnonzero(np.diff(_BLANK[body], prepend=True, append=True)) + offset
        self.starts: Integers = edges[0::2]
        self.ends: Integers = edges[1::2]
        newline = 10 if (body == 10).any() else 13
        line = np.searchsorted(np.flatnonzero(body == newline) + offset, self.starts)
        self.first: Integers = np.flatnonzero(np.diff(line, prepend=-1))
        self.counts: Integers = np.diff(self.first, append=line.size)
        self.numbers: Integers = line[self.first] + 1 + lines_before

    def drop_comments(self) -> None:
        """Forget the lines that start with #."""
        keep = np.frombuffer(self.data, np.uint8)[self.starts[self.first]] != ord("#")
        self.first, self.counts, self.numbers = (
            self.first[keep],
            self.counts[keep],
            self.numbers[keep],
        )

    def values(self, words: Integers) -> NDArray[np.float64]:
        """The numbers [...] that the words with these indices [...] spell; InputError where one is not a number."""
        values = np.empty(words.size)
        spans = zip(
            self.starts[words].ravel().tolist(), self.ends[words].ravel().tolist(), strict=True
        )
        for k, (start, end) in enumerate(spans):
            word = self.data[start:end]
            try:
                # float() takes 1_0 for 10.
                values[k] = float(word if b"_" not in word and len(word) <= _LONGEST else "")
            except ValueError:
                line = self.numbers[np.searchsorted(self.first, words.flat[k], side="right") - 1]
                text = shown(word.decode("ascii", "backslashreplace"))
                raise InputError(
                    f"{self.path}: line {line} has {text}, expected a number"
                ) from None
        return values.reshape(words.shape)
