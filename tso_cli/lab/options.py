"""The options that commands of studies share."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..io.shipped import LEARNED


@dataclass(frozen=True)
class Option:
    """An option of a study's command.

    Parameters
    ----------
    kind : type of the value; bool for a flag, which has none.
    help : names the default where ``default`` is None or empty.
    least, most : of a number. choices : the only values, if there are any.
    multiple : the option may be repeated; `Study.plan` gets a tuple without duplicates.
    name : of the parameter of `Study.plan`, where it differs from the flag's.
    """

    flag: str
    help: str = ""
    kind: type = str
    default: Any = None
    choices: tuple[str, ...] = ()
    least: int | None = None
    most: int | None = None
    required: bool = False
    multiple: bool = False
    name: str = ""

    @property
    def parameter(self) -> str:
        return self.name or self.flag.removeprefix("--").replace("-", "_")


MESHES = Option(
    "--meshes", "Folder with CATEGORY/NAME for every name of the split.", Path, required=True
)
SPLIT = Option("--split", "JSON file or folder of lists.  [default: the shipped network's]", Path)
CHECKPOINT = Option("--checkpoint", "View-aligned network.", Path, Path("default"))
UNSEEN = Option("--unseen", "Folder of meshes in no list, with index.csv.", Path)
FOLDERS = (MESHES.flag, UNSEEN.flag)
"""Written as DIR in the commands that records keep."""
PRIOR = Option(
    "--prior", "Learned prior: learned, none, or a file of tso train --prior.", Path, Path(LEARNED)
)
LIMIT = Option("--limit", "At most N shapes of each category.", int, least=1)
SEED = Option("--seed", "Seed of everything random.", int, 0, least=0, most=2**63 - 1)
COMMON = (MESHES, SPLIT, LIMIT, SEED)


def part(default: str, *choices: str) -> Option:
    """The list of the split whose shapes are evaluated."""
    return Option("--part", default=default, choices=choices or ("test", "validation"))


def categories(*default: str, note: str = "3, or all of --split") -> Option:
    text = "May be repeated." + ("" if default else f"  [default: {note}]")
    return Option("--category", text, default=default, multiple=True, name="categories")


def views(default: int) -> Option:
    return Option("--views", "Random views of each shape.", int, default, least=1)


def pictures(what: str) -> Option:
    return Option("--pictures", f"Draw {what} here (.png).", Path)
