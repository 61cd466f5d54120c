"""Output files are written whole or not at all, and never over another file without being asked.

While a file is written it is .NAME.xxxxxxxxxxxx.SUFFIX beside it. Its writer locks it: what is there without a lock is of a run
that was killed, and the next one to write the same file removes it. Long work that writes a file again and again holds
.NAME.lock beside it.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from ..errors import InputError


def check_output(path: Path, overwrite: bool) -> None:
    """Before the work starts, raise InputError for an output that cannot or, without ``overwrite``, must not be written."""
    try:
        folder = Path(os.path.realpath(path)).parent
        if path.is_dir():
            raise InputError(f"{path}: is a folder, expected the name of a file to write")
        if not folder.exists():
            raise InputError(
                f"{path}: the folder {folder} does not exist, expected one to write to"
            )
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
def atomic_output(path: Path, overwrite: bool = True) -> Iterator[Path]:
    """Yield a temporary path beside ``path``, with its suffix; on success it takes that name, else it is removed.

    A symbolic link stays, and the file it points to is replaced.

    Raises InputError if writing failed or, without ``overwrite``, if by then another file has the name.
    """
    try:
        target = Path(os.path.realpath(path))
        temporary = target.with_name(f".{target.stem[:40]}.{os.urandom(6).hex()}{target.suffix}")
        _sweep(target)
        # Created here, so that the file gets the permissions the user's umask asks for and the name is surely ours.
        os.close(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be written ({reason(error)})") from None
    held = lock(temporary)
    try:
        yield temporary
        # A full disk may show only when the data leave the memory.
        handle = os.open(temporary, os.O_RDWR)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
        if overwrite:
            temporary.replace(target)
        else:
            _take_name(temporary, target)
    except FileExistsError:
        raise InputError(f"{path}: exists already, expected a new name or --overwrite") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({reason(error)}), nothing was kept") from None
    finally:
        with suppress(OSError):
            temporary.unlink()
        if held is not None:
            os.close(held)


def write_file(path: Path, data: bytes, overwrite: bool = False) -> None:
    """Write a whole file, or none; InputError as `check_output` and `atomic_output`."""
    check_output(path, overwrite)
    with atomic_output(path, overwrite) as temporary:
        temporary.write_bytes(data)


def _take_name(temporary: Path, target: Path) -> None:
    """Give a file a name that no other has; FileExistsError where one has it."""
    try:
        os.link(temporary, target)
    except FileExistsError:
        raise
    except OSError:
        # A file system without links: an empty file holds the name for the moment.
        os.close(os.open(target, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
        temporary.replace(target)


def _sweep(target: Path) -> None:
    """Remove what killed runs left of ``target``."""
    name = re.compile(rf"\.{re.escape(target.stem[:40])}\.[0-9a-f]{{12}}{re.escape(target.suffix)}")
    with suppress(OSError), os.scandir(target.parent) as entries:
        for entry in entries:
            if (
                name.fullmatch(entry.name)
                and entry.is_file(follow_symlinks=False)
                and (held := lock(Path(entry))) is not None
            ):
                os.unlink(entry)
                os.close(held)


@contextmanager
def sole_writer(path: Path) -> Iterator[None]:
    """Work on ``path`` for as long as this lasts; InputError where another process does. Where no lock can be had, both do.

    A killed process keeps nobody out, nor do processes that it forked.
    """
    target = Path(os.path.realpath(path))
    place, held = target.with_name(f".{target.name}.lock"), None
    try:
        import fcntl

        while held is None:
            held = os.open(place, os.O_CREAT | os.O_RDWR, 0o666)
            # In contrast to that of `lock`, this lock is no child's.
            fcntl.lockf(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if not os.fstat(held).st_nlink:  # the one before removed it in between
                os.close(held)
                held = None
    except BlockingIOError:
        assert held is not None
        os.close(held)
        raise InputError(
            f"{path}: another process is writing it, expected another name, or to wait for it"
        ) from None
    except (ImportError, OSError, ValueError):
        pass
    try:
        yield
    finally:
        if held is not None:
            with suppress(OSError):
                place.unlink()
            os.close(held)


def lock(path: Path) -> int | None:
    """Lock a file or folder, until what is returned is closed or the process ends; None where it is locked or cannot be."""
    try:
        import fcntl

        handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    except (ImportError, OSError):
        return None
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(handle)
        return None
    return handle


def reason(error: BaseException) -> str:
    """What the system or a library says of ``error``, on one line and without a path."""
    text = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    text = " ".join(text.split()) or type(error).__name__
    # Libraries quote damaged files, whose control characters have no place on a terminal.
    text = "".join(letter if letter.isprintable() else ascii(letter)[1:-1] for letter in text)
    return text if len(text) <= 200 else text[:197] + "..."
