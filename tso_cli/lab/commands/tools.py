"""`tso lab page`, `fingerprint` and `generate`: what there is beside the studies."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

import click

from ...commands import options
from ...errors import GateError, InputError
from ...io.reading import shown
from ...version import __version__
from ..studies import BENCHES, QUESTIONS
from ..study import Study, answer, undamaged
from .records import read_record, write_page

records_argument = click.argument("records", nargs=-1, required=True, type=options.FilePath())


def load(name: str) -> Study:
    """The study of that name."""
    module, attribute = (QUESTIONS | BENCHES)[name][0].rsplit(".", 1)
    study: Study = getattr(import_module(f"tso_cli.lab.{module}"), attribute)
    return study


@click.command("page")
@records_argument
def page(records: tuple[Path, ...]) -> None:
    """Write the pages and charts of RECORDS anew, beside them, and run nothing."""
    for path in records:
        record = read_record(path)
        name = record.get("study")
        if name not in (*QUESTIONS, *BENCHES):
            raise InputError(
                f"{path}: is of the study {shown(name)}, expected one of {', '.join((*QUESTIONS, *BENCHES))}"
            )
        if not record.get("complete", True):
            raise InputError(
                f"{path}: is not complete, expected a finished record (--resume finishes it)"
            )
        study = load(name)
        with undamaged(f"{path}: the record"):
            answer(study, record)  # before anything is written
            write_page(study, record, path)
        click.echo(path.with_suffix(".md"))


@click.command("fingerprint")
@records_argument
def fingerprint(records: tuple[Path, ...]) -> None:
    """Whether RECORDS are of the method as it is, by their fingerprints: what it makes of the shipped examples.

    The exit code is 3 where one differs or is missing; then the study is to be run again.
    """
    from ..studies.fingerprint import differences

    changes = {}
    for path in records:
        with undamaged(f"{path}: the record"):
            changes[path] = differences(read_record(path))
    for path, lines in changes.items():
        click.echo(
            "\n  ".join(
                [f"{path}: of {'another method' if lines else 'the method as it is'}", *lines]
            )
        )
    if others := sum(map(bool, changes.values())):
        raise GateError(
            f"{others} of {len(records)} records are not known to be of the method as it is"
        )


@click.command("generate")
@click.option(
    "-o",
    "--output",
    type=options.FilePath(),
    required=True,
    help="Folder to write CATEGORY/gen_00000.ply and so on into.",
)
@click.option("--chair", type=int, default=300, show_default=True, help="How many chairs.")
@click.option("--car", type=int, default=300, show_default=True, help="How many cars.")
@click.option("--airplane", type=int, default=300, show_default=True, help="How many aeroplanes.")
@options.seed
@options.overwrite
@options.as_json
def generate(
    output: Path, chair: int, car: int, airplane: int, seed: int, overwrite: bool, as_json: bool
) -> None:
    """Draw chairs, cars and aeroplanes by rule and write them as meshes.

    No two are alike, each is reproducible from the seed, and asking for more (with --overwrite) gives the same ones first. They
    are there to train on beside real shapes where those are few, not to be judged on. y is up; chairs and cars face +z,
    aeroplanes fly toward -x.
    `tso render` makes pictures of them.
    """
    from ..generate import write_shapes

    counts = {"chair": chair, "car": car, "airplane": airplane}
    written = write_shapes(output, counts, seed, options.ProgressBar("generating"), overwrite)
    if as_json:
        options.echo_json(
            {
                "output": output,
                "counts": counts,
                "written": len(written),
                "seed": seed,
                "version": __version__,
            }
        )
    else:
        each = ", ".join(f"{count} of {category}" for category, count in counts.items() if count)
        click.echo(f"{len(written)} shapes written into {output} ({each}, seed {seed})")
