"""`tso lab generate`: shapes drawn by rule, to train on."""

from __future__ import annotations

from pathlib import Path

import click

from ...commands import options


@click.command("generate")
@click.option(
    "-o", "--output", type=options.FilePath(), required=True, help="Folder to write CATEGORY/gen_00000.ply and so on into."
)
@click.option("--chair", type=int, default=300, show_default=True, help="How many chairs.")
@click.option("--car", type=int, default=300, show_default=True, help="How many cars.")
@click.option("--airplane", type=int, default=300, show_default=True, help="How many aeroplanes.")
@options.seed
@options.overwrite
@options.as_json
def command(output: Path, chair: int, car: int, airplane: int, seed: int, overwrite: bool, as_json: bool) -> None:
    """Draw chairs, cars and aeroplanes by rule and write them as meshes.

    No two are alike, each is reproducible from the seed, and asking for more (with --overwrite) gives the same ones first. They
    are there to train on beside real shapes where those are few, not to be judged on. y is up; chairs and cars face +z,
    aeroplanes fly toward -x.
    `tso render` makes pictures of them.
    """
    from ...version import __version__
    from ..generate import write_shapes

    counts = {"chair": chair, "car": car, "airplane": airplane}
    written = write_shapes(output, counts, seed, options.ProgressBar("generating"), overwrite)
    if as_json:
        options.echo_json({"output": output, "counts": counts, "written": len(written), "seed": seed, "version": __version__})
    else:
        each = ", ".join(f"{count} of {category}" for category, count in counts.items() if count)
        click.echo(f"{len(written)} shapes written into {output} ({each}, seed {seed})")
