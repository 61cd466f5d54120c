"""Errors a user can act on. `cli` turns them into one line and an exit code; nothing else catches them."""


class TsoError(Exception):
    """A failure with a message fit to print as it stands: the file, what was found, what was expected."""

    exit_code = 1


class InputError(TsoError):
    """Wrong usage, or input that is unreadable or impossible."""

    exit_code = 2


class GateError(TsoError):
    """The work was done, but a bound that was asked for does not hold."""

    exit_code = 3
