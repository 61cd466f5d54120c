"""Input files: bytes, JSON documents, arrays (.npy) and tables of numbers.

What cannot be read is an InputError with one line that says why. Nothing is unpickled.
"""

from __future__ import annotations

import hashlib
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
from ..geometry.arrays import Array, Indices
from .output import reason

_LONGEST_QUOTE = 60  # characters of a file that a message quotes
_BLANK = np.isin(np.arange(256), list(b"\t\n\v\f\r "))
_HEADER_READERS = {
    (1, 0): np.lib.format.read_array_header_1_0,
    (2, 0): np.lib.format.read_array_header_2_0,
}


def read_bytes(path: Path, expected: str, limit: int | None = None, most: int = -1) -> bytes:
    """The bytes of the regular file ``path``; with ``most`` >= 0 only the first ``most`` bytes.

    Raises InputError if the file is missing, not a regular file, unreadable, empty or larger than
    ``limit`` bytes. The message says what is ``expected``.
    """
    try:
        status = path.stat()
        if stat.S_ISDIR(status.st_mode):
            raise InputError(f"{path}: is a folder, expected {expected}")
        if not stat.S_ISREG(status.st_mode):
            raise InputError(f"{path}: is not a regular file, expected {expected}")
        if status.st_size == 0:
            raise InputError(f"{path}: is empty, expected {expected}")
        if limit is not None and status.st_size > limit:
            raise InputError(
                f"{path}: holds {status.st_size:,} bytes, expected {expected} of at most {limit:,}"
            )
        if most < 0:
            require_memory(path, 2 * status.st_size)
        with path.open("rb") as stream:
            return stream.read(most)
    except (FileNotFoundError, NotADirectoryError):
        raise InputError(f"{path}: does not exist, expected {expected}") from None
    except MemoryError:
        raise InputError(f"{path}: does not fit into memory") from None
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read ({reason(error)}), expected {expected}") from None


def is_there(file: Path) -> bool:
    """Whether a file that another file names exists; its name may be impossible."""
    try:
        return file.is_file()
    except (OSError, ValueError):
        return False


def require_memory(path: Path, needed: int) -> None:
    """Raise InputError unless ``needed`` bytes of memory are free for what is in ``path``."""
    if needed > (free := free_memory()):
        need = f"needs about {needed / 2**30:.2g} GiB of memory"
        raise InputError(f"{path}: {need}, expected at most the {free / 2**30:.2g} that are free")


def free_memory() -> float:
    """Bytes of memory that are free on this machine, or in the container if that is less.

    Infinite if the system does not say, which only Linux does.
    """
    free = math.inf
    with suppress(OSError, ValueError, IndexError):
        free = 1024.0 * int(
            Path("/proc/meminfo").read_text().partition("MemAvailable:")[2].split()[0]
        )
        group = Path("/sys/fs/cgroup")
        of_container = int((group / "memory.max").read_text()) - int(
            (group / "memory.current").read_text()
        )
        free = min(free, of_container)
    return free


def read_json(
    path: Path,
    expected: str,
    form: str,
    limit: int | None = None,
    build: Callable[[list[tuple[str, Any]]], Any] = dict,
) -> Any:
    """The JSON document in ``path``; ``build`` makes its objects from their keys and values.

    Raises InputError as `read_bytes`, or if the file is not JSON; ``form`` says what is expected.
    """
    try:
        return json.loads(read_bytes(path, expected, limit), object_pairs_hook=build)
    except (RecursionError, ValueError) as error:
        raise InputError(f"{path}: is not JSON ({json_reason(error)}), expected {form}") from None


def json_reason(error: BaseException) -> str:
    """Why a text is no JSON, as `reason`; of very long numbers Python gives advice on Python."""
    if isinstance(error, RecursionError):
        return "nested too deep"
    return "a number has thousands of digits" if "set_int_max" in str(error) else reason(error)


def shown(value: object) -> str:
    """``value`` as a message may quote it: one printable line, shortened if it is long."""
    try:
        text = ascii(value)
    except (RecursionError, ValueError):
        text = f"a {type(value).__name__}"
    return text if len(text) <= _LONGEST_QUOTE else text[: _LONGEST_QUOTE - 3] + "..."


def plain(text: str) -> str:
    """A word of a file as a message may print it: as it is if it is short and printable."""
    return text if text.isprintable() and 0 < len(text) <= _LONGEST_QUOTE else shown(text)


def read_array(
    data: bytes, path: Path, kinds: str = "biufc", expected: str = "numbers"
) -> NDArray[Any]:
    """The read-only array in ``data``, the bytes of the .npy file ``path``.

    Raises InputError if ``data`` is not such a file, is shorter or longer than its header says, or
    has values of a type that is not one of numpy's ``kinds``; messages call them ``expected``.
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
    """The header of a .npy file: type, shape, whether columns come first, where values begin.

    Raises InputError if ``data`` is not such a file.
    """
    stream = io.BytesIO(data)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            version = np.lib.format.read_magic(stream)
            if version not in _HEADER_READERS:
                raise ValueError(f"version {version[0]}.{version[1]}, expected 1.0 or 2.0")
            shape, fortran, dtype = _HEADER_READERS[version](stream)
    # numpy evaluates the header as a Python literal: a damaged header can raise nearly anything.
    except Exception as error:
        raise InputError(f"{path}: is not a readable .npy file ({reason(error)})") from None
    return dtype, shape, fortran, stream.tell()


class TextTable:
    """The words of ``data[offset:]`` and their lines.

    starts, ends : [T], the bytes at which each word starts and ends.
    first : [L], index of the first word of each line; blank lines are left out.
    counts : [L], how many words each line has.
    numbers : [L], number of each line in the file, from 1.
    """

    def __init__(self, data: bytes, path: Path, offset: int = 0, lines_before: int = 0) -> None:
        self.data, self.path = data, path
        body = np.frombuffer(data, np.uint8, offset=offset)
        edges = np.flatnonzero(np.diff(_BLANK[body], prepend=True, append=True)) + offset
        self.starts: Indices = edges[0::2]
        self.ends: Indices = edges[1::2]
        newline = ord("\n") if (body == ord("\n")).any() else ord("\r")
        line = np.searchsorted(np.flatnonzero(body == newline) + offset, self.starts)
        self.first: Indices = np.flatnonzero(np.diff(line, prepend=-1))
        self.counts: Indices = np.diff(self.first, append=line.size)
        self.numbers: Indices = line[self.first] + 1 + lines_before

    def drop_comments(self) -> None:
        """Forget the lines that start with #, or with // as CloudCompare writes them."""
        keep = ~np.isin(np.frombuffer(self.data, np.uint8)[self.starts[self.first]], list(b"#/"))
        self.first, self.counts = self.first[keep], self.counts[keep]
        self.numbers = self.numbers[keep]

    def values(self, words: Indices) -> Array:
        """The numbers [...] in the words with the indices ``words`` [...].

        Raises InputError if a word is not a number.
        """
        values = np.empty(words.size)
        spans = zip(
            self.starts[words].ravel().tolist(), self.ends[words].ravel().tolist(), strict=True
        )
        for k, (start, end) in enumerate(spans):
            word = self.data[start:end]
            try:
                # float() would read 1_0 as 10.
                plain = b"_" not in word and len(word) <= 100
                values[k] = float(word if plain else "")
            except ValueError:
                line = self.numbers[np.searchsorted(self.first, words.flat[k], side="right") - 1]
                text = shown(word.decode("ascii", "backslashreplace"))
                raise InputError(
                    f"{self.path}: line {line} has {text}, expected a number such as 0.5 or 1e-3"
                ) from None
        return values.reshape(words.shape)


def name_of(path: Path, expected: str) -> str:
    """The name of a file and the digest of its bytes, which say later which file it was.

    Raises InputError as `read_bytes`.
    """
    return f"{path.name}, {hashlib.sha256(read_bytes(path, expected)).hexdigest()[:16]}"


def digest_of(path: Path) -> str:
    """SHA-256 of a file; of a folder that of the names, sizes and times of its files."""
    digest = hashlib.sha256()
    try:
        if not path.is_dir():
            if path.exists() and not path.is_file():
                raise InputError(f"{path}: is not a regular file, expected one")
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
