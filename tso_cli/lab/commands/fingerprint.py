"""`tso lab fingerprint`."""

from __future__ import annotations

from pathlib import Path

import click

from ...commands import options
from ...errors import GateError
from .records import read_record


@click.command("fingerprint")
@click.argument("records", nargs=-1, required=True, type=options.FilePath())
def command(records: tuple[Path, ...]) -> None:
    """Whether RECORDS are of the method as it is, by their fingerprints: what it makes of the shipped examples.

    The exit code is 3 where one differs or is missing; then the study is to be run again.
    """
    from ..studies.fingerprint import differences

    changes = {path: differences(read_record(path)) for path in records}
    for path, lines in changes.items():
        click.echo("\n  ".join([f"{path}: of {'another method' if lines else 'the method as it is'}", *lines]))
    if others := sum(map(bool, changes.values())):
        raise GateError(f"{others} of {len(records)} records are not known to be of the method as it is")
