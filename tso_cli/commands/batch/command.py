"""`tso batch`: many clouds, each refined once, whatever happens meanwhile."""

from __future__ import annotations

import click

from .. import options
from .options import BatchOptions


@options.command("batch", BatchOptions)
def command(ctx: click.Context, chosen: BatchOptions) -> None:
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
        from .run import BatchRun
    ctx.exit(BatchRun(chosen).run())
