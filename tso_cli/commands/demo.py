"""`tso demo`: refine the shipped chair, judge it before and after, and draw it."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from pathlib import Path

import click

from ..io.output import make_folder
from ..io.shipped import examples_folder
from ..option import opt
from . import options


@dataclass(frozen=True, kw_only=True)
class DemoOptions:
    """What `tso demo` may be given.

    output : Folder to write to; files of an earlier demo are replaced.
    """

    output: Path = opt(Path("demo"), names=("-o", "output"))


@options.command("demo", DemoOptions)
def command(ctx: click.Context, chosen: DemoOptions) -> None:
    """Refine the shipped chair, and compare it with its true shape, before and after.

    Writes chair.ply, chair.png (the picture of --overlay) and chair.html (the page of --report).
    """
    chair = examples_folder() / "chair"
    initial, target = chair / "initial.ply", chair / "target.ply"
    output = chosen.output
    make_folder(output)
    cloud, picture, page = (output / f"chair.{suffix}" for suffix in ("ply", "png", "html"))
    _run(
        "refine", initial, chair / "mask.png",
        "-o", cloud, "--overlay", picture, "--report", page, "--overwrite",
    )  # fmt: skip
    for name, result in (("before", initial), ("after", cloud)):
        click.echo(f"{name}:")
        _run("eval", "--chamfer", result, target)
    click.echo(f"picture: {picture}")
    click.echo(f"page: {page}")


def _run(name: str, *words: str | Path) -> None:
    """Print a command of tso as a line for a shell, and run it."""
    root = click.get_current_context().find_root()
    group, arguments = root.command, [str(word) for word in words]
    assert isinstance(group, click.Group)
    subcommand = group.get_command(root, name)
    assert subcommand is not None
    click.echo(f"$ {shlex.join(['tso', name, *arguments])}")
    try:
        with subcommand.make_context(name, arguments, parent=root) as context:
            subcommand.invoke(context)
    except click.exceptions.Exit as end:
        if end.exit_code:
            raise
