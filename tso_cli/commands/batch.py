"""`tso batch`: many clouds, each refined once, whatever happens meanwhile."""

from __future__ import annotations

from typing import Any

import click

from . import options
from .options import FilePath, choice, flag, option

ENGINES = ("processes", "dask")


class Shard(click.ParamType):
    """i/n, the i-th of n parts."""

    name = "I/N"

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[int, int]:
        index, slash, count = str(value).partition("/")
        if not slash or not index.isdecimal() or not count.isdecimal():
            self.fail(f"{value!r}, expected I/N such as 1/8.", param, ctx)
        if not 1 <= int(index) <= int(count):
            self.fail(f"{value!r}, expected I from 1 to N.", param, ctx)
        return int(index), int(count)


def is_address(value: object) -> bool:
    from ..batch.remote import is_remote

    return is_remote(value)


class PathOrAddress(FilePath):
    """A path, or an address as text."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        return value if is_address(value) else super().convert(value, param, ctx)


class LocalPath(FilePath):
    """A path that is no address."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if is_address(value):
            self.fail(
                f"{value} is an address, expected a folder, where the journal is; name addresses "
                "of results in the column output.", param, ctx,
            )  # fmt: skip
        return super().convert(value, param, ctx)


@click.command("batch", cls=options.Command, headings={"output": "Output", "jobs": "Running"})
@click.argument("manifest", metavar="MANIFEST|FOLDER", type=PathOrAddress())
@option(
    "--output", "Folder for the results and the journal; it is made if need be.", "-o",
    type=LocalPath(), required=True,
)  # fmt: skip
@flag("--strict", "Write no doubtful results.")
@options.overwrite
@flag("--report", "Also write OUT/index.html, a table of all items with pictures.")
@option(
    "--jobs",
    "Processes.  [default: one for each core, or OMP_NUM_THREADS]",
    "-j",
    type=options.Whole(1),
)
@option(
    "--shard", "Do only the I-th of N parts of the items, as one of N machines.", type=Shard(),
    metavar="I/N",
)  # fmt: skip
@choice("--engine", "Processes of this machine, or a cluster of dask.", *ENGINES)
@option("--scheduler", "Address of dask's scheduler, such as tcp://10.0.0.1:8786.")
@flag("-q", "Print nothing but errors.", "--quiet")
@options.as_json
@click.pass_context
def command(ctx: click.Context, **chosen: Any) -> None:
    """Refine many clouds, each by its own masks: the items of MANIFEST.

    \b
    tso batch items.csv -o results
    tso batch FOLDER -o results

    A manifest is CSV or JSON Lines with the columns `cloud`, `mask` (several: a.png;b.png),
    `camera`, `output`, and any option of `tso refine` by its name. Its paths are relative to its
    folder, and `-` is stdin. In a folder, files belong together by their names: chair.ply,
    chair.png, chair.camera.json.

    OUT/journal.jsonl says of each item what became of it. If the batch ends early, however it
    ends, the same command goes on: what is done stays, and only items whose files or settings have
    changed are done again. The exit code is 3 if an item failed, was refused or is doubtful.
    """
    with options.loading():
        from .batch_run import BatchRun
    ctx.exit(options.pick(BatchRun, chosen).run())
