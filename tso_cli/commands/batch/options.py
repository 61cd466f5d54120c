"""The options of `tso batch`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import click

from ...errors import InputError
from ...option import check, opt
from .. import options


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


class PathOrAddress(options.FilePath):
    """A path, or an address as text."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if "://" in str(value):
            from ...batch.remote import is_remote, local_path

            value = local_path(str(value))
            if is_remote(value):
                return value
        return super().convert(value, param, ctx)


@dataclass(frozen=True, kw_only=True)
class BatchOptions:
    """What `tso batch` may be given; InputError for options that do not go together.

    manifest : The items, or a folder of them.
    output : Folder for the results and the journal; it is made if need be.
    strict : Write no doubtful results.
    report : Also write OUT/index.html, a table of all items with pictures.
    jobs : Processes.
    item_seconds : End an item as failed that takes longer.
    shard : Do only the I-th of N parts of the items, as one of N machines.
    engine : Processes of this machine, or a cluster of dask.
    scheduler : Address of dask's scheduler, such as tcp://10.0.0.1:8786.
    """

    manifest: Any = opt(
        options.REQUIRED, role="argument", metavar="MANIFEST|FOLDER", parser=PathOrAddress()
    )
    output: Path = opt(
        options.REQUIRED, heading="Output", names=("-o", "output"), parser=PathOrAddress()
    )
    strict: bool = opt(False)
    overwrite: bool = options.overwrite()
    report: bool = opt(False)
    jobs: int | None = opt(
        None,
        "one for each core, or OMP_NUM_THREADS",
        heading="Running",
        names=("-j", "jobs"),
        least=1,
    )
    item_seconds: float | None = opt(
        None, "no limit", above=0.0, most=1e6, only={"engine": ("processes",)}
    )
    shard: Any = opt(None, metavar="I/N", parser=Shard())
    engine: Literal["processes", "dask"] = opt("processes")
    scheduler: str | None = opt(None, only={"engine": ("dask",)})
    quiet: bool = options.quiet()
    as_json: bool = options.as_json()

    def __post_init__(self) -> None:
        check(self)
        if isinstance(self.output, str):
            raise InputError(
                f"-o {self.output} is an address, expected a folder, where the journal is; name "
                "addresses of results in the column output"
            )
