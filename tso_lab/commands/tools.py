"""`tso lab records`, `tso lab page` and `tso lab fingerprint`: tools for all records."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

import click

from tso_cli.commands import options
from tso_cli.errors import GateError, InputError, TsoError
from tso_cli.io.reading import shown
from tso_cli.workers.pool import cores

from .. import options as lab_options
from ..studies import WORDS
from ..study import Study, answer, undamaged
from .records import read_record, write_page, write_record

records_argument = click.argument("records", nargs=-1, required=True, type=options.PATH)


def load(name: str) -> Study:
    """The study of that name."""
    module, attribute = WORDS[name]["study"].rsplit(".", 1)
    study: Study = getattr(import_module(f"tso_lab.{module}"), attribute)
    return study


@click.command("records")
@click.argument("names", nargs=-1)
@click.option("--meshes", type=options.PATH, help=lab_options.MESHES.option.help)
@click.option("--unseen", type=options.PATH, help=lab_options.UNSEEN.option.help)
@click.option("--photos", type=options.PATH, help="Folder of the photos, with their _par.txt.")
@click.option(
    "--jobs",
    type=click.IntRange(1),
    metavar="N",
    help="Records that are made at once, each on one core.  [default: the cores]",
)
@click.option("-o", "--output", type=options.PATH, required=True, help="Folder of the records.")
def records(
    names: tuple[str, ...],
    meshes: Path | None,
    unseen: Path | None,
    photos: Path | None,
    jobs: int | None,
    output: Path,
) -> None:
    """Make the records NAMES (all) in a folder again, as far as they are due.

    A record is due if it is missing or incomplete, or was made by another method or with other
    settings. Cheap ones come first, and those that measure time last, each alone. The same command
    again goes on where it was interrupted.
    """
    from .renewal import all_due, make, needs

    output.mkdir(parents=True, exist_ok=True)
    due = all_due(output, names)
    folders = {"--meshes": meshes, "--unseen": unseen, "--photos": photos}
    needs(due, folders)
    failed = make(due, output, folders, jobs or cores())
    for record in due:
        if record.kept.name not in failed:
            click.echo(output / f"{record.kept.name}.json")
    if failed:
        raise TsoError(f"{len(failed)} of {len(due)} records were not made: {', '.join(failed)}")


@click.command("page")
@records_argument
def page(records: tuple[Path, ...]) -> None:
    """Write the pages and charts of RECORDS again, without running anything.

    What the records conclude from their cases, and the words for it, are made again too.
    """
    for path in records:
        record = read_record(path)
        name = record.get("study")
        if name not in WORDS:
            names = ", ".join(WORDS)
            raise InputError(f"{path}: is of the study {shown(name)}, expected one of {names}")
        if not record.get("complete", True):
            expected = "expected a finished record (--resume finishes it)"
            raise InputError(f"{path}: is not complete, {expected}")
        study = load(name)
        with undamaged(f"{path}: the record"):
            answer(study, record)  # before anything is written
            record = study.renewed(record)
            write_page(study, record, path)
        write_record(record, path)
        click.echo(path.with_suffix(".md"))


@click.command("fingerprint")
@records_argument
def fingerprint(records: tuple[Path, ...]) -> None:
    """Whether RECORDS were made by the method as it is.

    Compares their fingerprints: what the method makes of the shipped examples. The exit code is 3
    where one differs or is missing; then its study is to be run again.
    """
    from ..studies.fingerprint import differences

    changes = {}
    for path in records:
        with undamaged(f"{path}: the record"):
            changes[path] = differences(read_record(path))
    for path, lines in changes.items():
        method = "another method" if lines else "the method as it is"
        click.echo("\n  ".join([f"{path}: of {method}", *lines]))
    if others := sum(map(bool, changes.values())):
        found = f"{others} of {len(records)} records"
        raise GateError(f"{found} are not known to be of the method as it is")
