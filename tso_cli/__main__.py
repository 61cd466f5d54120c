"""The program: `tso`, and `python -m tso_cli`."""

import signal


def main() -> None:
    """Run the command line; Ctrl-C while it is imported ends the program without a word."""
    by_default = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if by_default:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    from .cli import main as command_line

    if by_default:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    command_line()


if __name__ == "__main__":
    main()
