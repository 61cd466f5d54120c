"""What a study is: a question, the options of its command, the cases that it judges, and how its record is shown."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..errors import InputError
from ..io.output import reason
from ..plots.table import Cell, text_table
from ..version import __version__
from .studies import BENCHES, QUESTIONS

Record = dict[str, Any]
Cases = list[Record]
Report = Callable[[str, int, int], None]
"""Called with (what is being done, done, total)."""


@dataclass(frozen=True)
class Option:
    """An option of a study's command.

    ``kind`` is bool for a flag without a value. ``help`` names the default where ``default`` is None or empty. With
    ``multiple`` `Study.plan` gets a tuple without duplicates. ``name`` is that of its parameter, if not that of the flag.
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
SPLIT = Option(
    "--split", "JSON file, or a folder of lists.  [default: that of the shipped network]", Path
)
CHECKPOINT = Option("--checkpoint", "View-aligned network.", Path, Path("default"))
CATEGORY = Option(
    "--category",
    "May be repeated.  [default: 3, or all of --split]",
    str,
    (),
    multiple=True,
    name="categories",
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
        return "\n".join(
            filter(None, (self.title, text_table(self.header, self.rows, self.decimals), self.note))
        )

    def markdown(self) -> str:
        """For a page."""
        shown = [
            text_table([name], [[row[i]] for row in self.rows], self.decimals)
            for i, name in enumerate(self.header)
        ]
        lines = [
            list(map(str.strip, line))
            for line in zip(*(column.split("\n") for column in shown), strict=True)
        ]
        lines[1] = ["---"] * len(self.header)
        table = "\n".join(f"| {' | '.join(line)} |" for line in lines)
        return "\n\n".join(filter(None, (self.title and f"### {self.title}", table, self.note)))


@dataclass(frozen=True, eq=False)
class Progress:
    """What a study resumes from, and where it reports to.

    ``earlier`` is the record to resume, ``keep`` is called with the record so far, and ``overwrite`` says whether files that
    the study itself writes may be replaced. ``source`` is what messages call the earlier record.
    """

    report: Report = lambda what, done, total: None
    earlier: Record | None = None
    keep: Callable[[Record], None] = lambda record: None
    overwrite: bool = False
    source: str = "the record to go on from"


@contextmanager
def undamaged(source: str) -> Iterator[None]:
    """InputError where the record that messages call ``source`` cannot be concluded from, compared or shown."""
    try:
        yield
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
        found = f"{error} is missing" if isinstance(error, KeyError) else reason(error)
        raise InputError(f"{source} is damaged ({found}), expected it as it was kept") from None


@dataclass(frozen=True, eq=False)
class Plan:
    """The work of a study.

    settings : of the record; only a record with equal ones is resumed.
    jobs : (values that only the cases of this job share, function that judges them); the record is kept after each.
    doing : what is reported. finish : called with the complete record.
    """

    settings: Record
    jobs: Sequence[tuple[Record, Callable[[], Cases]]]
    doing: str = "refining"
    finish: Callable[[Record], None] = lambda record: None


@dataclass(frozen=True, kw_only=True)
class Study:
    """A question to the method: ``plan`` says what to do for ``options``, ``conclude`` what all cases together say.

    ``about`` is the help of its command, below the question. ``parts`` are those of the method that its `fingerprint` is of;
    ``tables`` and ``draw`` (path, record, overwrite) show a record, ``reading`` says on its page what it means.
    """

    name: str
    about: str = ""
    parts: tuple[str, ...]
    tables: Callable[[Record], list[Table]]
    draw: Callable[[Path, Record, bool], None]
    reading: str
    convention: Record
    options: tuple[Option, ...]
    plan: Callable[..., Plan]
    conclude: Callable[[Cases], Record]

    @property
    def question(self) -> str:
        return (QUESTIONS | BENCHES)[self.name][1]

    @property
    def command(self) -> str:
        return f"tso {'bench' if self.name in BENCHES else 'lab'} {self.name}"

    def run(self, progress: Progress, **options: Any) -> Record:
        """The record of all cases; those of ``progress.earlier`` are not judged again.

        Raises InputError if the earlier record is of another study or of other settings.
        """
        began = time.monotonic()
        plan = self.plan(progress, **options)
        cases = self._earlier_cases(progress, plan.settings)
        record = self._checked_record(plan, cases, progress, began)
        progress.keep(record)
        for number, (shared, judge) in enumerate(plan.jobs, 1):
            if not _judged(shared, cases):
                cases = [*cases, *judge()]
                record = self._checked_record(plan, cases, progress, began)
                progress.keep(record)
            progress.report(plan.doing, number, len(plan.jobs))
        plan.finish(record)
        return record

    def _checked_record(self, plan: Plan, cases: Cases, progress: Progress, began: float) -> Record:
        """The record; InputError where cases of an earlier one cannot be concluded from or shown."""
        if progress.earlier is None:
            return self._record(plan, cases, time.monotonic() - began)
        with undamaged(progress.source):
            record = self._record(
                plan, cases, progress.earlier.get("seconds", 0.0) + time.monotonic() - began
            )
            for table in self.tables(record) if record["complete"] else ():
                table.text()
        return record

    def _record(self, plan: Plan, cases: Cases, seconds: float) -> Record:
        complete = all(_judged(shared, cases) for shared, _ in plan.jobs)
        head = {
            "study": self.name,
            "version": __version__,
            "convention": self.convention,
            "complete": complete,
        }
        conclusions = self.conclude(cases) if complete else {}
        return {
            **head,
            "seconds": seconds,
            "settings": plan.settings,
            **conclusions,
            "cases": cases,
        }

    def _earlier_cases(self, progress: Progress, settings: Record) -> Cases:
        if progress.earlier is None:
            return []
        name, before, cases = (progress.earlier.get(key) for key in ("study", "settings", "cases"))
        text = progress.source
        if name != self.name or not isinstance(before, dict) or not isinstance(cases, list):
            raise InputError(f"{text} is of the study {name!r}, expected one of {self.command}")
        # As a record has them: tuples are lists there.
        for key, value in json.loads(json.dumps(settings)).items():
            if before.get(key) != value:
                raise InputError(
                    f"{text} has {key} {before.get(key)!r}, now it is {value!r}; expected the same"
                )
        return cases


def _judged(shared: Record, cases: Cases) -> bool:
    return any(shared.items() <= case.items() for case in cases)


def claim(text: str, holds: bool, measured: str) -> Record:
    """One of a record's claims: whether it holds, and the figures that say so."""
    return {"claim": text, "holds": bool(holds), "found": measured}


def claim_line(claim: Record) -> str:
    """A claim as tables and pages state it."""
    return f"{'holds' if claim['holds'] else 'target missed'}: {claim['claim']} ({claim['found']})"


def answer(study: Study, record: Record) -> str:
    """Tables, convention and claims of a record, for a terminal."""
    claims = "\n".join(map(claim_line, record.get("claims", [])))
    return "\n\n".join(
        filter(
            None, (*(table.text() for table in study.tables(record)), _convention(record), claims)
        )
    )


def page(study: Study, record: Record, file_name: str, more_charts: Sequence[str] = ()) -> str:
    """The page of the record in ``file_name``, NAME.json, as Markdown; its chart is NAME.png beside it."""
    parts = [
        f"# {study.question}",
        f"    {record.get('command', study.command)} -o {file_name}",
        study.reading,
        f"![{study.question}]({file_name.removesuffix('.json')}.png)",
        *(f"![{name}]({name})" for name in more_charts),
        *(table.markdown() for table in study.tables(record)),
        "\n".join(f"- {claim_line(claim)}" for claim in record.get("claims", [])),
        _convention(record, "- "),
    ]
    return "\n\n".join(filter(None, parts)) + "\n"


def _convention(record: Record, bullet: str = "") -> str:
    return "\n".join(f"{bullet}{name}: {meaning}" for name, meaning in record["convention"].items())
