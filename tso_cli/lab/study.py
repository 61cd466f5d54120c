"""What a study is: a question, the options of its command, how it runs, and how its record is shown."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..errors import InputError
from ..plots.table import Cell, text_table
from ..version import __version__
from .studies import QUESTIONS

Record = dict[str, Any]
Cases = list[dict[str, Any]]
Report = Callable[[str, int, int], None]
"""Called with (what is being done, done, total)."""


@dataclass(frozen=True)
class Option:
    """An option of a study's command.

    ``kind`` is bool for a flag without a value. ``help`` names the default where ``default`` is None or empty. With
    ``multiple`` `Study.run` gets a tuple without duplicates. ``name`` is that of its parameter, if not that of the flag.
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


MESHES = Option("--meshes", "Folder with CATEGORY/NAME for every name of the split.", Path, required=True)
SPLIT = Option("--split", "JSON file, or a folder of lists.  [default: that of the shipped network]", Path)
CHECKPOINT = Option("--checkpoint", "View-aligned network.", Path, Path("default"))
CATEGORY = Option(
    "--category", "May be repeated.  [default: 3, or all of --split]", multiple=True, default=(), name="categories"
)
LIMIT = Option("--limit", "At most so many shapes of each category.", int, least=1)
VIEWS = Option("--views", "Random views of each shape.", int, 2, least=1)
SEED = Option("--seed", "Seed of everything random.", int, 0, least=0, most=2**63 - 1)
DEVICE = Option("--device", "cpu, cuda, cuda:1, mps or auto.", default="cpu")
COMMON = (MESHES, SPLIT, LIMIT, SEED)


def part(default: str, *choices: str) -> Option:
    """Which list of the split is judged."""
    return Option("--part", default=default, choices=choices or ("test", "validation"))


@dataclass(frozen=True)
class Table:
    """A table of a record: ``header``, and ``rows`` with as many cells each; ``title`` above it, ``note`` below it."""

    header: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    title: str = ""
    note: str = ""
    decimals: int = 3

    def text(self) -> str:
        """For a terminal."""
        return "\n".join(filter(None, (self.title, text_table(self.header, self.rows, self.decimals), self.note)))

    def markdown(self) -> str:
        """For a page."""
        columns = [
            text_table([name], [[row[i]] for row in self.rows], self.decimals).split("\n") for i, name in enumerate(self.header)
        ]
        lines = [[cell.strip() for cell in line] for line in zip(*columns, strict=True)]
        lines[1] = ["---"] * len(self.header)
        table = "\n".join(f"| {' | '.join(line)} |" for line in lines)
        return "\n\n".join(filter(None, (self.title and f"### {self.title}", table, self.note)))


@dataclass(frozen=True, eq=False)
class Progress:
    """What a study goes on from, and where it reports to.

    ``earlier`` is the record to go on from, ``keep`` is called with the record so far, ``unfinished`` is the checkpoint beside
    which a network in training is kept, and ``overwrite`` says whether files that the study itself writes may be replaced.
    """

    report: Report = lambda what, done, total: None
    earlier: Record | None = None
    keep: Callable[[Record], None] = lambda record: None
    unfinished: Path | None = None
    overwrite: bool = False

    def earlier_cases(self, study: str, settings: dict[str, Any]) -> Cases:
        """The cases of the earlier record; InputError if it is of another study or of other settings."""
        if self.earlier is None:
            return []
        name, before, cases = (self.earlier.get(key) for key in ("study", "settings", "cases"))
        if name != study or not isinstance(before, dict) or not isinstance(cases, list):
            raise InputError(f"the record to go on from is of the study {name!r}, expected one of tso lab {study}")
        for key, value in settings.items():
            if before.get(key) != value:
                raise InputError(
                    f"the record to go on from has {key} {before.get(key)!r}, now it is {value!r}; expected the same"
                )
        return list(cases)

    def complete(
        self,
        doing: str,
        cases: Cases,
        groups: Sequence[Callable[[], Cases] | None],
        record: Callable[[Cases, bool], Record],
    ) -> Record:
        """The record of ``cases`` and of what ``groups`` add to them, kept after every group.

        A group is None where ``cases`` has it already; ``record`` takes the cases so far, and whether these are all.
        """
        for number, judge in enumerate(groups, 1):
            if judge is not None:
                cases = cases + judge()
                self.keep(record(cases, number == len(groups)))
            self.report(doing, number, len(groups))
        return record(cases, True)


@dataclass(frozen=True)
class Study:
    """A question to the method, and how it is answered.

    ``tables`` and ``draw`` (path, record, overwrite) show a record, which `run` makes from the options; ``reading`` says on its
    page what it means. ``kept`` says when the record is kept; it is empty where the study cannot be resumed.
    """

    name: str
    about: str
    options: tuple[Option, ...]
    run: Callable[..., Record]
    tables: Callable[[Record], list[Table]]
    draw: Callable[[Path, Record, bool], None]
    reading: str = ""
    kept: str = ""

    @property
    def question(self) -> str:
        return QUESTIONS[self.name][1] if self.name in QUESTIONS else self.about


def record_of(study: str, convention: dict[str, str] | str, **content: Any) -> Record:
    """A record of the version at hand."""
    return {"study": study, "version": __version__, "convention": convention, **content}


def claim(text: str, holds: bool, found: str) -> dict[str, Any]:
    """One of a record's claims: whether it holds, and the figures that say so."""
    return {"claim": text, "holds": bool(holds), "found": found}


def claim_line(claim: dict[str, Any]) -> str:
    """A claim as tables and pages state it."""
    return f"{'holds' if claim['holds'] else 'target missed'}: {claim['claim']} ({claim['found']})"


def answer(study: Study, record: Record) -> str:
    """Tables, convention and claims of a record, for a terminal."""
    claims = "\n".join(map(claim_line, record.get("claims", [])))
    return "\n\n".join(filter(None, (*(table.text() for table in study.tables(record)), _convention(record), claims)))


def page(study: Study, record: Record, file_name: str, more_charts: Sequence[str] = ()) -> str:
    """The page of the record in ``file_name``, NAME.json, as Markdown; its chart is NAME.png beside it."""
    parts = [
        f"# {study.question}",
        f"    {record.get('command', f'tso lab {study.name}')} -o {file_name}",
        study.reading,
        f"![{study.question}]({file_name.removesuffix('.json')}.png)",
        *(f"![{name}]({name})" for name in more_charts),
        *(table.markdown() for table in study.tables(record)),
        "\n".join(f"- {claim_line(claim)}" for claim in record.get("claims", [])),
        _convention(record, "- "),
    ]
    return "\n\n".join(filter(None, parts)) + "\n"


def _convention(record: Record, bullet: str = "") -> str:
    convention = record.get("convention", {})
    if isinstance(convention, str):
        convention = {"Chamfer": convention}
    return "\n".join(f"{bullet}{name}: {meaning}" for name, meaning in convention.items())
