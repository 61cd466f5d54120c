"""The options that commands of studies share."""

from __future__ import annotations

from dataclasses import MISSING
from pathlib import Path
from typing import Any

from tso_cli.io.shipped import LEARNED
from tso_cli.option import Declared, Option


def option(
    flag: str,
    help: str = "",
    kind: type = str,
    default: Any = None,
    *,
    choices: tuple[str, ...] = (),
    required: bool = False,
    multiple: bool = False,
    name: str = "",
    short: str = "",
    **limits: Any,
) -> Declared:
    """An option of a study's command.

    kind : type of the value; bool for a flag, which has none.
    help : names the default where ``default`` is None or empty.
    multiple : the option may be repeated; `Study.plan` gets a tuple without duplicates.
    name : of the parameter of `Study.plan`, where it differs from the flag's.
    short : another flag, such as -o.
    """
    name = name or flag.removeprefix("--").replace("-", "_")
    details = Option(help=help, names=(short, flag) if short else (flag,), **limits)
    default = MISSING if required else default
    return Declared(name, details, default, kind, multiple, 1, choices, default is None)


def meshes(required: bool = True) -> Declared:
    help = "Folder with CATEGORY/NAME for every name of the split."
    return option("--meshes", help, Path, required=required)


def unseen(required: bool = False) -> Declared:
    help = "Folder of meshes in no list, with index.csv."
    return option("--unseen", help, Path, required=required)


MESHES, UNSEEN = meshes(), unseen()
SPLIT = option("--split", "JSON file or folder of lists.  [default: the shipped network's]", Path)
CHECKPOINT = option("--checkpoint", "View-aligned network.", Path, Path("default"))
FOLDERS = (MESHES.flag, UNSEEN.flag)
"""Written as DIR in the commands that records keep."""
PRIOR = option(
    "--prior", "Learned prior: learned, none, or a file of tso train-prior.", Path, Path(LEARNED)
)
LIMIT = option("--limit", "At most N shapes of each category.", int, least=1)
SEED = option("--seed", "Seed of everything random.", int, 0, least=0, most=2**63 - 1)
COMMON = (MESHES, SPLIT, LIMIT, SEED)


def part(default: str, *choices: str) -> Declared:
    """The list of the split whose shapes are evaluated."""
    return option("--part", default=default, choices=choices or ("test", "validation"))


def categories(*default: str, note: str = "3, or all of --split") -> Declared:
    text = "May be repeated." + ("" if default else f"  [default: {note}]")
    return option("--category", text, default=default, multiple=True, name="categories")


def views(default: int) -> Declared:
    return option("--views", "Random views of each shape.", int, default, least=1)
