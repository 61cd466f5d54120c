"""Random damage to files, and the promise that every reader keeps when it meets it."""

import re
import struct
import warnings
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import tso_cli
from tso_cli.errors import InputError

NASTY_NUMBERS = [
    b"0",
    b"1",
    b"-1",
    b"2",
    b"255",
    b"65536",
    b"2147483648",
    b"99999999999999999999",
    b"1" * 5000,
]
NASTY_NUMBERS += [b"1e400", b"nan", b"-inf"]
NASTY_WORDS = [
    *NASTY_NUMBERS,
    b"",
    b"\x00",
    b"list",
    b"[",
    b"{}",
    b'""',
    b"null",
    b"true",
    b"x",
    b"(",
    b"\xff\xfe",
    b"\n",
]
BOUNDARIES = [0, 1, 2, 127, 128, 254, 255]


def corruptions(data: bytes, count: int) -> Iterator[bytes]:
    """``count`` damaged copies of ``data``, the same ones each time; some are damaged several
    times.
    """
    rng = np.random.default_rng(0)
    kinds = [
        _truncate,
        _flip,
        _overwrite,
        _insert,
        _delete,
        _repeat,
        _change_word,
        _change_header_number,
    ]
    for i in range(count):
        damaged = data
        for _ in range(int(rng.choice([1, 1, 1, 2, 5]))):
            kind = (
                kinds[i % len(kinds)] if damaged is data else kinds[int(rng.integers(len(kinds)))]
            )
            damaged = kind(damaged, rng)
        yield damaged


def assert_reads_or_refuses(
    read: Callable[[Path], Any],
    path: Path,
    count: int,
    repair: Callable[[bytes], bytes] | None = None,
) -> tuple[int, int]:
    """Damage the good file ``path`` ``count`` times; ``read`` must keep the promise of `is_read`
    every time.

    ``repair`` (checksums, say) is applied to every second damaged copy, so that the damage reaches
    what the checksums protect. Returns how many were read and how many were refused.
    """
    good = path.read_bytes()
    victim = path.with_name("damaged" + path.suffix)
    was_read = 0
    for i, data in enumerate(corruptions(good, count)):
        # A new file each time: some file systems wait for the disk when a file is written over.
        victim.unlink(missing_ok=True)
        victim.write_bytes(repair(data) if repair is not None and i % 2 else data)
        try:
            was_read += is_read(read, victim)
        except BaseException as error:
            raise AssertionError(f"damage {i}: {type(error).__name__}: {error}") from error
    return was_read, count - was_read


def is_read(read: Callable[[Path], Any], path: Path) -> bool:
    """Whether ``read`` reads a file; else it raises InputError with one line that names the file.

    No other exception may leave ``read``, and no warning but a UserWarning of one line.
    """
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            read(path)
            refusal = ""
        except InputError as error:
            refusal = str(error)
            assert path.name in refusal, f"{refusal!r} does not name the file"
            assert_one_line(refusal)
    for warning in caught:
        # What other packages have not mended yet is no matter of the file.
        if issubclass(warning.category, DeprecationWarning) and not _of_tso(warning.filename):
            continue
        assert warning.category is UserWarning, f"{warning.category.__name__}: {warning.message}"
        assert_one_line(str(warning.message))
    return not refusal


def assert_refused(message: str, read: Callable[..., Any], *arguments: Any, **options: Any) -> None:
    """``read`` raises InputError, with one line that matches ``message``."""
    with pytest.raises(InputError, match=message) as caught:
        read(*arguments, **options)
    assert_one_line(str(caught.value))


def _of_tso(file: str) -> bool:
    return Path(file).is_relative_to(Path(tso_cli.__file__).parent)


def assert_one_line(text: str) -> None:
    """A message fit for a terminal: printable, short, without a line break."""
    assert text.isprintable(), f"{text!r} is not one printable line"
    assert len(text) < 600, f"{len(text)} characters: {text[:100]!r}..."


def full_disk(*_: Any, **__: Any) -> None:
    """Stands for a function that writes."""
    raise OSError(28, "No space left on device")


def repair_png(data: bytes) -> bytes:
    """``data`` with the checksums of its chunks made right, as far as chunks can be followed."""
    out = bytearray(data)
    at = 8
    while at + 12 <= len(out):
        (length,) = struct.unpack_from(">I", out, at)
        if at + 12 + length > len(out):
            break
        struct.pack_into(">I", out, at + 8 + length, zlib.crc32(out[at + 4 : at + 8 + length]))
        at += 12 + length
    return bytes(out)


def _place(data: bytes, rng: np.random.Generator) -> int:
    """Half of the time among the first bytes, where files say what they are."""
    end = min(len(data), 200) if rng.random() < 0.5 else len(data)
    return int(rng.integers(end)) if end else 0


def _truncate(data: bytes, rng: np.random.Generator) -> bytes:
    return data[: int(rng.integers(len(data) + 1))]


def _flip(data: bytes, rng: np.random.Generator) -> bytes:
    out = bytearray(data)
    for _ in range(int(rng.integers(1, 9)) if out else 0):
        out[_place(data, rng)] ^= 1 << int(rng.integers(8))
    return bytes(out)


def _overwrite(data: bytes, rng: np.random.Generator) -> bytes:
    at, size = _place(data, rng), int(rng.integers(1, 9))
    fill = (
        [int(rng.choice(BOUNDARIES))] * size
        if rng.random() < 0.5
        else rng.integers(0, 256, size).tolist()
    )
    return (data[:at] + bytes(fill) + data[at + size :])[: len(data)]


def _insert(data: bytes, rng: np.random.Generator) -> bytes:
    at = _place(data, rng)
    return (
        data[:at]
        + rng.integers(0, 256, int(rng.integers(1, 20)), dtype=np.uint8).tobytes()
        + data[at:]
    )


def _delete(data: bytes, rng: np.random.Generator) -> bytes:
    at = _place(data, rng)
    return data[:at] + data[at + int(rng.integers(1, 20)) :]


def _repeat(data: bytes, rng: np.random.Generator) -> bytes:
    at = _place(data, rng)
    return data[:at] + data[at : at + int(rng.integers(1, 100))] + data[at:]


def _change_word(data: bytes, rng: np.random.Generator) -> bytes:
    return _replace(data, rb"[^\s,:\[\]{}()]+", NASTY_WORDS, rng)


def _change_header_number(data: bytes, rng: np.random.Generator) -> bytes:
    return _replace(data, rb"[0-9]+", NASTY_NUMBERS, rng, 300)


def _replace(
    data: bytes,
    pattern: bytes,
    by: list[bytes],
    rng: np.random.Generator,
    within: int | None = None,
) -> bytes:
    found = list(re.finditer(pattern, data[:within]))
    if not found:
        return _flip(data, rng)
    match = found[int(rng.integers(len(found)))]
    return data[: match.start()] + by[int(rng.integers(len(by)))] + data[match.end() :]
