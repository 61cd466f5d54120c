"""What a study is: a question, its options, its cases, and how its record is shown."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from tso_cli.errors import InputError, Interrupted
from tso_cli.io.output import reason
from tso_cli.option import Declared
from tso_cli.plots.table import Cell, text_table
from tso_cli.version import __version__

from .studies import WORDS

if TYPE_CHECKING:
    from .studies.shapes import Shape

T = TypeVar("T")
Record = dict[str, Any]
Cases = list[Record]
Draw = Callable[[Path, Record, bool], None]
Report = Callable[[str, int, int], None]
"""Called with (what is being done, done, total)."""


@dataclass(frozen=True)
class Table:
    """A table of a record, with ``title`` above it and ``note`` below it."""

    header: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    title: str = ""
    note: str = ""
    decimals: int = 3

    def text(self) -> str:
        """For a terminal."""
        table = text_table(self.header, self.rows, self.decimals)
        return "\n".join(filter(None, (self.title, table, self.note)))

    def markdown(self) -> str:
        """For a page."""
        columns = [
            text_table([name], [[row[i]] for row in self.rows], self.decimals).split("\n")
            for i, name in enumerate(self.header)
        ]
        lines = [[cell.strip() for cell in line] for line in zip(*columns, strict=True)]
        lines[1] = ["---"] * len(self.header)
        table = "\n".join(f"| {' | '.join(line)} |" for line in lines)
        return "\n\n".join(filter(None, (self.title and f"### {self.title}", table, self.note)))


def crossed(
    cells: Mapping[str, Mapping[str, Cell]], corner: str = "", title: str = "", **more: Any
) -> Table:
    """The table of ``cells``, label of a row -> label of a column -> cell."""
    columns = list(dict.fromkeys(label for row in cells.values() for label in row))
    rows = [[label, *map(row.get, columns)] for label, row in cells.items()]
    return Table([corner, *columns], rows, title, **more)


@dataclass(frozen=True, eq=False)
class Progress:
    """What a study resumes from, and where it reports to.

    ``earlier`` is the record to resume, which messages call ``source``; ``keep`` is called with the
    record so far; ``overwrite`` says whether files that the study itself writes may be replaced.
    """

    report: Report = lambda what, done, total: None
    earlier: Record | None = None
    keep: Callable[[Record], None] = lambda record: None
    overwrite: bool = False
    source: str = "the record to go on from"


@contextmanager
def undamaged(source: str) -> Iterator[None]:
    """Raises InputError where the record that messages call ``source`` is damaged."""
    try:
        yield
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
        found = f"{error} is missing" if isinstance(error, KeyError) else reason(error)
        raise InputError(f"{source} is damaged ({found}), expected it as it was kept") from None


@dataclass(frozen=True, eq=False)
class Plan:
    """The work of a study.

    settings : of the record; only a record with equal settings is resumed.
    jobs : (values that only the cases of this job share, function that makes these cases). The
        record is kept after each job.
    doing : what is reported. finish : called with the complete record.
    """

    settings: Record
    jobs: Sequence[tuple[Record, Callable[[], Cases]]]
    doing: str = "refining"
    finish: Callable[[Record], None] = lambda record: None


@dataclass(frozen=True, kw_only=True)
class Study:
    """A question to the method.

    Its words are in `studies/words.toml`; ``values`` are those that the words name in braces, and
    ``more_convention`` is added to theirs. ``plan`` says what to do for ``options``; ``conclude``
    says what all cases together mean. ``parts`` are the parts of the method whose `fingerprint`
    the record keeps. ``tables`` and ``draw`` (path, record, overwrite) show a record.
    """

    name: str
    values: Record = field(default_factory=dict)
    more_convention: Record = field(default_factory=dict)
    parts: tuple[str, ...]
    tables: Callable[[Record], list[Table]]
    draw: Draw
    options: tuple[Declared, ...]
    plan: Callable[..., Plan]
    conclude: Callable[[Cases], Record]

    @property
    def question(self) -> str:
        text: str = WORDS[self.name]["question"].removeprefix("Paper: ")
        return text[0].upper() + text[1:]

    @property
    def about(self) -> str:
        """The help of the command, below the question."""
        text: str = WORDS[self.name]["about"]
        return text.format_map(self.values) if self.values else text

    @property
    def convention(self) -> Record:
        """What the figures of the record mean."""
        texts = WORDS[self.name]["convention"].items()
        return {key: text.format_map(self.values) for key, text in texts} | self.more_convention

    @property
    def command(self) -> str:
        return f"tso lab {self.name}"

    def run(self, progress: Progress, **options: Any) -> Record:
        """The record of all cases; the cases of ``progress.earlier`` are not made again.

        Raises InputError if the earlier record is of another study or of other settings.
        """
        began = time.monotonic()
        plan = self.plan(progress, **options)
        cases = self._earlier_cases(progress, plan.settings)
        record = self._record(plan, cases, progress, began)
        progress.keep(record)
        for number, (shared, make_cases) in enumerate(plan.jobs, 1):
            if not _has_cases_of(shared, cases):
                cases = [*cases, *make_cases()]
                record = self._record(plan, cases, progress, began)
                progress.keep(record)
            progress.report(plan.doing, number, len(plan.jobs))
        plan.finish(record)
        return record

    def renewed(self, record: Record) -> Record:
        """The record with conclusions, convention and command as the study words them now."""
        options = str(record.get("command", "")).partition(f" {self.name}")[2]
        words = {"convention": self.convention, "command": self.command + options}
        return {**record, **words, **self.conclude(record["cases"])}

    def _record(self, plan: Plan, cases: Cases, progress: Progress, began: float) -> Record:
        """The record so far; InputError where cases of an earlier record are damaged."""
        complete = all(_has_cases_of(shared, cases) for shared, _ in plan.jobs)
        earlier = progress.earlier or {}
        with undamaged(progress.source) if earlier else nullcontext():
            record = {
                "study": self.name,
                "version": __version__,
                "convention": self.convention,
                "complete": complete,
                "seconds": earlier.get("seconds", 0.0) + time.monotonic() - began,
                "settings": plan.settings,
                **(self.conclude(cases) if complete else {}),
                "cases": cases,
            }
            for table in self.tables(record) if earlier and complete else ():
                table.text()
        return record

    def _earlier_cases(self, progress: Progress, settings: Record) -> Cases:
        if progress.earlier is None:
            return []
        name, before, cases = (progress.earlier.get(key) for key in ("study", "settings", "cases"))
        text = progress.source
        if name != self.name or not isinstance(before, dict) or not isinstance(cases, list):
            raise InputError(f"{text} is of the study {name!r}, expected one of {self.command}")
        # In JSON tuples are lists.
        for key, value in json.loads(json.dumps(settings)).items():
            if before.get(key) != value:
                raise InputError(
                    f"{text} has {key} {before.get(key)!r}, now it is {value!r}; expected the same"
                )
        return cases


def by_shape(
    settings: Record,
    shapes: Sequence[Shape],
    make_cases: Callable[[Shape], Cases],
    doing: str = "refining",
) -> Plan:
    """A job for each shape; the settings name the shapes."""
    settings = {**settings, "shapes": [shape.name for shape in shapes]}
    jobs = [({"shape": shape.name}, partial(make_cases, shape)) for shape in shapes]
    return Plan(settings, jobs, doing)


def uninterrupted(result: T) -> T:
    """What `refine`, an item of `refine_batch` or `train` returned.

    Raises KeyboardInterrupt where Ctrl-C ended it: those functions keep the best so far, and no
    number is to be made of that.
    """
    outcome = getattr(result, "fit", result)
    if getattr(outcome, "stop_reason", "") == "interrupted" or isinstance(result, Interrupted):
        raise KeyboardInterrupt
    return result


def _has_cases_of(shared: Record, cases: Cases) -> bool:
    return any(isinstance(case, dict) and shared.items() <= case.items() for case in cases)


def claim(text: str, holds: bool, measured: str) -> Record:
    """One of a record's claims: whether it holds, and the figures that show it."""
    return {"claim": text, "holds": bool(holds), "found": measured}


def claim_line(claim: Record) -> str:
    """A claim as tables and pages state it."""
    return f"{'holds' if claim['holds'] else 'target missed'}: {claim['claim']} ({claim['found']})"


def answer(study: Study, record: Record) -> str:
    """Tables, convention and claims of a record, for a terminal."""
    tables = (table.text() for table in study.tables(record))
    claims = "\n".join(map(claim_line, record.get("claims", [])))
    return "\n\n".join(filter(None, (*tables, _convention(record), claims)))


def page(study: Study, record: Record, file_name: str, more_charts: Sequence[str] = ()) -> str:
    """The page of the record in ``file_name``, NAME.json, as Markdown; its chart is NAME.png."""
    parts = [
        f"# {study.question}",
        f"    {record.get('command', study.command)} -o {file_name}",
        WORDS[study.name]["reading"],
        f"![{study.question}]({file_name.removesuffix('.json')}.png)",
        *(f"![{name}]({name})" for name in more_charts),
        *(table.markdown() for table in study.tables(record)),
        "\n".join(f"- {claim_line(claim)}" for claim in record.get("claims", [])),
        _convention(record, "- "),
    ]
    return "\n\n".join(filter(None, parts)) + "\n"


def _convention(record: Record, bullet: str = "") -> str:
    return "\n".join(f"{bullet}{name}: {meaning}" for name, meaning in record["convention"].items())
