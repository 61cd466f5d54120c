"""Output files are written whole or not at all, and never over another file without being asked."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from ..errors import InputError


def check_output(path: Path, overwrite: bool) -> None:
    """Before the work starts, raise InputError for an output that cannot or, without ``overwrite``, must not be written."""
    path = Path(path)
    try:
        folder = Path(os.path.realpath(path)).parent
        if path.is_dir():
            raise InputError(f"{path}: is a folder, expected the name of a file to write")
        if not folder.exists():
            raise InputError(f"{path}: the folder {folder} does not exist, expected one to write to")
        if not folder.is_dir():
            raise InputError(f"{path}: {folder} is not a folder, expected one to write to")
        if path.exists() and not path.is_file():
            raise InputError(f"{path}: is not a regular file, expected the name of a file to write")
        if path.exists() and not overwrite:
            raise InputError(f"{path}: exists already, expected a new name or --overwrite")
        if not os.access(folder, os.W_OK | os.X_OK):
            raise InputError(f"{path}: the folder {folder} is not writable")
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be written ({reason(error)})") from None


@contextmanager
def atomic_output(path: Path) -> Iterator[Path]:
    """Yield a temporary path beside ``path``, with its suffix; on success it takes that name, else it is removed.

    A symbolic link stays, and the file it points to is replaced. Raises InputError if writing failed.
    """
    path = Path(path)
    try:
        target = Path(os.path.realpath(path))
        temporary = target.with_name(f".{target.stem[:40]}.{os.urandom(6).hex()}{target.suffix}")
        # Created here, so that the file gets the permissions the user's umask asks for and the name is surely ours.
        os.close(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be written ({reason(error)})") from None
    try:
        yield temporary
        # A full disk may show only when the data leave the memory.
        handle = os.open(temporary, os.O_RDWR)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
        temporary.replace(target)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({reason(error)}), nothing was kept") from None
    finally:
        with suppress(OSError):
            temporary.unlink()


def reason(error: BaseException) -> str:
    """What the system or a library says of ``error``, on one line and without a path."""
    text = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    text = " ".join(text.split()) or type(error).__name__
    # Libraries quote damaged files, whose control characters have no place on a terminal.
    text = "".join(letter if letter.isprintable() else ascii(letter)[1:-1] for letter in text)
    return text if len(text) <= 200 else text[:197] + "..."
