"""Output files are written whole or not at all, and replace another file only if the user asks.

While NAME.SUFFIX is written it is the file .NAME.xxxxxxxx.0.SUFFIX in the same folder. The letters
x are a digest of the whole name. The writer locks this temporary file, and the number grows while
another process holds it. A killed run leaves a file without a lock, which the next run that writes
the same file takes. Without locks, random letters stand in place of the number. Long work that
writes a file again and again holds a lock on .NAME.SUFFIX.lock in the same folder.
"""

from __future__ import annotations

import errno
import hashlib
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from ..errors import InputError

_LONGEST_REASON = 200  # characters


def check_output(path: Path, overwrite: bool) -> None:
    """Raise InputError, before the work starts, if the file ``path`` cannot be written.

    A file that exists may be replaced only with ``overwrite``.
    """
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
        # A link that leads nowhere yet would make a file elsewhere.
        if os.path.lexists(path) and not overwrite:
            raise InputError(f"{path}: exists already, expected a new name or `overwrite`")
        if not os.access(folder, os.W_OK | os.X_OK):
            raise InputError(f"{path}: the folder {folder} is not writable")
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be written ({reason(error)})") from None


def require_output(path: Path, suffix: str, overwrite: bool) -> None:
    """InputError if the suffix of an output is wrong or the output cannot be written."""
    require_suffix(path, suffix)
    check_output(path, overwrite)


def require_suffix(path: Path, suffix: str) -> None:
    """InputError if the suffix of ``path`` is another."""
    if path.suffix.lower() != suffix:
        raise InputError(f"{path}: the suffix is {path.suffix!r}, expected {suffix}")


def make_folder(path: Path) -> None:
    """Make a folder to write to, unless it is there; InputError if it cannot be."""
    expected = "expected the name of a folder to write to"
    try:
        path.mkdir(parents=True, exist_ok=True)
    except FileExistsError:
        raise InputError(f"{path}: is a file, {expected}") from None
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be made ({reason(error)}), {expected}") from None


@contextmanager
def atomic_output(path: Path, overwrite: bool = True) -> Iterator[Path]:
    """Yield a temporary path in the folder of ``path``, with the same suffix.

    After success the temporary file becomes ``path``, after an error it is removed. A symbolic
    link stays, and the file that it points to is replaced.

    Raises InputError if writing failed or, without ``overwrite``, if ``path`` exists by then.
    """
    try:
        if not overwrite and path.is_symlink():
            raise InputError(f"{path}: exists already, expected a new name or `overwrite`")
        target = Path(os.path.realpath(path))
        temporary, lock = _new_temporary(target)
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be written ({reason(error)})") from None
    renamed = False
    try:
        yield temporary
        # A full disk may become apparent only when the data leave the memory.
        handle = os.open(temporary, os.O_RDWR)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
        if overwrite:
            temporary.replace(target)
            renamed = True
        else:
            renamed = _take_name(temporary, target)
    except FileExistsError:
        raise InputError(f"{path}: exists already, expected a new name or `overwrite`") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({reason(error)}), nothing was kept") from None
    finally:
        # After the renaming another process may have a file of this name.
        if not renamed:
            with suppress(OSError):
                temporary.unlink()
        if lock is not None:
            os.close(lock)


def write_file(path: Path, data: bytes, overwrite: bool = False) -> None:
    """Write a whole file or nothing; InputError as `check_output` and `atomic_output`."""
    check_output(path, overwrite)
    with atomic_output(path, overwrite) as temporary:
        temporary.write_bytes(data)


def _take_name(temporary: Path, target: Path) -> bool:
    """Give a file the name ``target``; FileExistsError if another file has it.

    Returns whether it has lost its old name.
    """
    try:
        os.link(temporary, target)
        return False
    except FileExistsError:
        raise
    except OSError:
        # This file system has no links: an empty file reserves the name for a moment.
        os.close(os.open(target, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
        temporary.replace(target)
        return True


def _stem(target: Path) -> str:
    """How the names of the temporaries of ``target`` begin; those of no other file do."""
    digest = hashlib.sha256(os.fsencode(target.name)).hexdigest()[:8]
    return f".{target.stem[:40]}.{digest}."


def _new_temporary(target: Path) -> tuple[Path, int | None]:
    """An empty file next to ``target``, and the handle that holds its lock, None without locks.

    Its name is the first that no living process holds. So the next run takes the file that a killed
    run has left, without a search of the folder, which may hold a million files.
    """
    try:
        import fcntl
    except ImportError:  # no locks here
        return _exclusive_temporary(target)
    number = 0
    while True:
        temporary = target.with_name(f"{_stem(target)}{number}{target.suffix}")
        # Creating the file here gives it the permissions of the user's umask.
        flags = os.O_CREAT | os.O_WRONLY | os.O_NOFOLLOW | os.O_NONBLOCK
        try:
            handle = os.open(temporary, flags, 0o666)
        except OSError as error:
            if error.errno not in (errno.ELOOP, errno.EISDIR, errno.ENXIO):
                raise
            number += 1  # a link, a folder or a pipe has the name
            continue
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(handle)
            number += 1
            continue
        except OSError:  # no locks on this file system
            os.close(handle)
            return _exclusive_temporary(target)
        state = os.fstat(handle)
        if not _has_name(temporary, state):
            os.close(handle)  # its last owner has renamed or removed it in between
            continue
        if state.st_uid != os.getuid() or state.st_nlink != 1 or not stat.S_ISREG(state.st_mode):
            os.close(handle)  # somebody else has put it there
            number += 1
            continue
        os.ftruncate(handle, 0)
        return temporary, handle


def _has_name(path: Path, state: os.stat_result) -> bool:
    try:
        return os.path.samestat(os.stat(path, follow_symlinks=False), state)
    except FileNotFoundError:
        return False


def _exclusive_temporary(target: Path) -> tuple[Path, None]:
    temporary = target.with_name(f"{_stem(target)}{os.urandom(6).hex()}{target.suffix}")
    os.close(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
    return temporary, None


@contextmanager
def sole_writer(path: Path) -> Iterator[None]:
    """Be the only process that writes ``path``; InputError if another process is writing it.

    A killed process holds no lock, and the processes that it forked hold none either. If the
    system has no locks, nothing is checked.
    """
    target = Path(os.path.realpath(path))
    place, lock = target.with_name(f".{target.name}.lock"), None
    try:
        import fcntl

        while lock is None:
            lock = os.open(place, os.O_CREAT | os.O_RDWR, 0o666)
            # Child processes do not inherit this lock; they would inherit the lock of `lock`.
            fcntl.lockf(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if not os.fstat(lock).st_nlink:  # its last owner removed the file in between
                os.close(lock)
                lock = None
    except BlockingIOError:
        assert lock is not None
        os.close(lock)
        raise InputError(
            f"{path}: another process is writing it, expected another name (or wait for it to end)"
        ) from None
    except (ImportError, OSError, ValueError):
        pass
    try:
        yield
    finally:
        if lock is not None:
            with suppress(OSError):
                place.unlink()
            os.close(lock)


def reason(error: BaseException) -> str:
    """What the system or a library says about ``error``, on one line and without a path."""
    text = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    text = " ".join(text.split()) or type(error).__name__
    # Libraries quote damaged files: their control characters must not reach a terminal.
    text = "".join(letter if letter.isprintable() else ascii(letter)[1:-1] for letter in text)
    return text if len(text) <= _LONGEST_REASON else text[: _LONGEST_REASON - 3] + "..."
