"""The command line: the subcommands, and how errors become messages and exit codes."""

from __future__ import annotations

import gc
import io
import os
import re
import signal
import sys
import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from typing import Any

import click

from .commands.options import CONTEXT, LazyGroup
from .errors import TsoError, is_interrupt, missing_extra
from .version import __version__

# Heading -> name -> (module, one line of help). The lines stand here so that `tso --help` imports
# no command.
SECTIONS = {
    "Your data": {
        "refine": (
            "tso_cli.commands.refine.command",
            "Move a cloud until it agrees with its masks.",
        ),
        "batch": (
            "tso_cli.commands.batch.command",
            "Refine many clouds, and go on where it ended.",
        ),
        "eval": (
            "tso_cli.commands.evaluate",
            "Compare clouds with ground truth: Chamfer, F-score, EMD, IoU.",
        ),
        "mask": ("tso_cli.commands.mask", "Show what a mask file shows, and write it as PNG."),
        "convert": ("tso_cli.commands.convert", "Convert clouds, meshes and camera files."),
    },
    "Networks": {
        "render": (
            "tso_cli.commands.render",
            "Render meshes: images, masks, cameras and point clouds.",
        ),
        "train": (
            "tso_cli.commands.train.command",
            "Train a network that predicts a cloud from a photo.",
        ),
        "train-prior": ("tso_cli.commands.train.prior", "Train a prior for tso refine."),
        "curves": ("tso_cli.commands.curves", "Draw the losses of trainings."),
        "export": ("tso_cli.commands.export", "Write a smaller copy of a network."),
    },
    "Set-up": {
        "doctor": ("tso_cli.commands.doctor", "Say what is installed, and how to get the rest."),
        "demo": ("tso_cli.commands.demo", "Refine the shipped chair, and judge the result."),
    },
}
if find_spec("tso_lab"):  # in a clone of the repository, not in the wheel
    SECTIONS["Research"] = {"lab": ("tso_lab.commands", "Studies and benchmarks of the method.")}


@click.group(
    cls=LazyGroup,
    sections=SECTIONS,
    context_settings=CONTEXT,
)
@click.version_option(__version__, prog_name="tso")
def tso() -> None:
    """Make a 3D point cloud agree with a picture.

    `tso COMMAND --help` explains a command, `tso COMMAND --help-all` shows all of its options.
    """


class _Stream(io.FileIO):
    """A stream that drops what it cannot write because of an error of type ``dropped``.

    Every other error is raised once.
    """

    def __init__(self, descriptor: int, dropped: type[OSError]) -> None:
        super().__init__(os.dup(descriptor), "w")
        self._dropped = dropped

    def write(self, data: Any) -> int:
        try:
            return super().write(data)
        except self._dropped:
            return len(data)
        except OSError:
            # Python flushes once more on exit, and would report the error a second time.
            self._dropped = OSError
            raise


class _Text(io.TextIOWrapper):
    """Text with control characters as escapes: names and contents of files may hold any.

    The frame of a progress bar stays. What the encoding lacks becomes an escape too.
    """

    def write(self, text: str) -> int:
        bar = _BAR.fullmatch(text)
        return super().write(f"\r{_escaped(bar[1])}{bar[2]}" if bar else _escaped(text))


_BAR = re.compile(r"\r(.*)(\x1b\[K\n?)")
_SUSPICIOUS = re.compile(r"[^\n\t -~]")


def _escaped(text: str) -> str:
    return _SUSPICIOUS.sub(
        lambda letter: letter[0] if letter[0].isprintable() else ascii(letter[0])[1:-1], text
    )


def _open_streams() -> None:
    """Make the standard streams safe to write to.

    1. If stdin, stdout or stderr is closed, no output file gets its number.
    2. If the reader of stdout or stderr goes away, the work goes on.
    3. Any text can be printed, and none controls the terminal.
    """
    while (spare := os.open(os.devnull, os.O_RDWR)) <= 2:
        os.set_inheritable(spare, True)
    os.close(spare)
    if sys.stderr is sys.__stderr__:  # not replaced by a caller
        encoding = sys.stderr.encoding if sys.stderr else "utf-8"
        # A copy of the descriptor: what C libraries print on 2 itself stays separate.
        sys.stderr = _Text(_Stream(2, OSError), encoding, "backslashreplace", write_through=True)
    if sys.stdout is sys.__stdout__ and (stdout := sys.__stdout__) is not None:
        # A reader may go away, as in `tso eval ... | head`; other errors of a file are reported.
        buffered = io.BufferedWriter(_Stream(1, BrokenPipeError))
        sys.stdout = _Text(
            buffered, stdout.encoding, "backslashreplace", line_buffering=stdout.line_buffering
        )


@contextmanager
def _ended_as_by_ctrl_c() -> Iterator[None]:
    """Let SIGTERM and SIGHUP do what Ctrl-C does: no half file stays, and a training is kept."""

    def interrupt(number: int, frame: Any) -> None:
        handler = signal.getsignal(signal.SIGINT)
        (handler if callable(handler) else signal.default_int_handler)(number, frame)

    before = {}
    if threading.current_thread() is threading.main_thread():
        for name in ("SIGTERM", "SIGHUP"):
            number = getattr(signal, name, None)  # Windows has no SIGHUP
            # nohup ignores SIGHUP, and it stays ignored.
            if number and signal.getsignal(number) is signal.SIG_DFL:
                before[number] = signal.signal(number, interrupt)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _print_warning(message: Warning | str, *_: Any, **__: Any) -> None:
    print(f"tso: warning: {_one_line(str(message))}", file=sys.stderr)


def main(arguments: list[str] | None = None) -> None:
    """Run the command line and exit.

    The exit codes are 0 done, 1 failed, 2 unusable input, 3 target missed (GateError),
    4 a cloud that --strict left as it was, and 130 interrupted.
    """
    # Objects made by imports stay: searching them for garbage takes 5 ms.
    gc.set_threshold(100_000)
    _open_streams()
    warnings.showwarning = _print_warning
    warnings.simplefilter("always", UserWarning)
    try:
        with _ended_as_by_ctrl_c():
            code = tso.main(arguments, prog_name="tso", standalone_mode=False)
    except TsoError as error:
        code = _fail(with_options(str(error)), error.exit_code)
    except click.UsageError as error:
        hint = f" (see `{error.ctx.command_path} --help`)" if error.ctx else ""
        code = _fail(f"{error.format_message()}{hint}", 2)
    except click.ClickException as error:
        code = _fail(error.format_message(), error.exit_code)
    except (ImportError, SystemError) as error:
        if is_interrupt(error):
            code = _fail("interrupted", 130)
        elif (message := missing_extra(error)) is None:
            raise
        else:
            code = _fail(message, 1)
    except (click.Abort, KeyboardInterrupt):
        code = _fail("interrupted", 130)
    except MemoryError:
        code = _fail("out of memory", 1)
    except OSError as error:
        code = _fail(f"{error.filename or 'stdout, or a file'}: {error.strerror or error}", 1)
    sys.exit(code if isinstance(code, int) else 0)


def _fail(message: str, code: int) -> int:
    print(f"tso: error: {_one_line(message)}", file=sys.stderr)
    return code


def with_options(message: str) -> str:
    """``message`` with parameters, which the library names in backquotes, as options."""
    return re.sub(r"`([a-z][a-z_]*)`", lambda name: f"--{name[1].replace('_', '-')}", message)


def _one_line(message: str) -> str:
    """``message`` as one printable line; the name of a file may hold control characters."""
    return _escaped(" ".join(message.split()))
