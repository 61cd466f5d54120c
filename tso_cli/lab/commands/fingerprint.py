"""`tso lab fingerprint`."""

from __future__ import annotations

from pathlib import Path

import click

from ...commands import options
from ...errors import GateError, InputError
from .records import read_record, write_record


@click.command("fingerprint")
@click.argument("records", nargs=-1, required=True, type=options.FilePath())
@click.option(
    "--complete", is_flag=True, help="Add what fingerprints have gained to those of RECORDS, where the rest is today's."
)
def command(records: tuple[Path, ...], complete: bool) -> None:
    """Whether RECORDS are of the method as it is: their fingerprints beside today's.

    A fingerprint is what the method does to the shipped examples, in a few numbers; every record that -o writes has one.
    The exit code is 3 where one differs or is missing. What differs is made anew by its own command: no option says that it
    need not be.
    """
    from ..studies.fingerprint import differences

    others = 0
    for path in records:
        record = read_record(path)
        try:
            changes = differences(record, lacking=not complete)
            if complete and not changes:
                write_record(record, path)
        except InputError as error:
            raise InputError(f"{path}: {error}") from None
        others += bool(changes)
        click.echo(f"{path}: " + ("of another method" if changes else "of the method as it is"))
        for line in changes:
            click.echo(f"  {line}")
    if others:
        raise GateError(f"{others} of {len(records)} records are not known to be of the method as it is")
