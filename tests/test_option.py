"""Options declared once: what follows from a field, and what is refused."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import click
import pytest

from tests.corruption import assert_refused
from tso_cli.commands import options
from tso_cli.commands.batch.options import BatchOptions
from tso_cli.commands.evaluate import EvalOptions
from tso_cli.commands.option_files import named, value_of
from tso_cli.commands.refine.options import RefineOptions
from tso_cli.commands.refine.outputs import NAMED
from tso_cli.commands.render import RenderOptions
from tso_cli.commands.train.options import TrainOptions, TrainPriorOptions
from tso_cli.option import check, declared, opt

KINDS = [
    RefineOptions, BatchOptions, EvalOptions, RenderOptions, TrainOptions, TrainPriorOptions,
]  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Bake:
    """What a baker may be given.

    flour : What the bread is of, such as `salt`, which
        is none.
    minutes : In the oven.
    salt : Grams of salt.
    seeds : Files of seeds.
    """

    flour: Literal["rye", "wheat"] = opt("rye", brief=True)
    minutes: int | None = opt(None, "60", least=1, most=90)
    salt: float = opt(9.0, above=0.0, below=math.inf, names=("grams",))
    seeds: tuple[Path, ...] = opt((), only={"flour": ("wheat",)}, why="rye has none")
    crust: bool = opt(False, help="With a crust.", needs=("seeds",), excludes=("minutes",))
    size: tuple[float, float] = opt((1.0, 2.0), help="Sides.", least=0.0)

    def __post_init__(self) -> None:
        check(self)


@options.command("bake", Bake)
def bake(ctx: click.Context, chosen: Bake) -> None:
    """Bake."""
    ctx.obj.append(chosen)


def baked(*words: str) -> Bake:
    found: list[Bake] = []
    bake.main(list(words), standalone_mode=False, obj=found)
    return found[0]


def test_the_command_line_makes_the_dataclass():
    words = ("--flour", "wheat", "--seeds", "a", "--seeds", "b", "--crust", "--size", "2", "3")
    assert baked(*words) == Bake(
        flour="wheat", seeds=(Path("a"), Path("b")), crust=True, size=(2.0, 3.0)
    )
    assert baked() == Bake()
    assert baked("--grams", "3").salt == 3.0


def test_the_help_is_the_docstring_and_names_options_as_they_are_typed():
    flour = declared(Bake)["flour"].option
    assert flour.help == "What the bread is of, such as `salt`, which is none."
    shown = bake.get_help(click.Context(bake))
    assert "--flour" in shown
    assert "--minutes" not in shown  # not brief


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"flour": "oat"}, "`flour` is 'oat', expected one of rye, wheat"),
        ({"flour": None}, "`flour` is None, expected one of rye, wheat"),
        ({"minutes": 0}, "`minutes` is 0, expected a whole number from 1 to 90"),
        ({"minutes": 2.0}, "`minutes` is 2, expected a whole number"),
        ({"minutes": True}, "`minutes` is True"),
        ({"salt": math.nan}, "`grams` is nan, expected a finite number, more than 0"),
        ({"salt": math.inf}, "`grams` is inf, expected a finite number"),
        ({"seeds": (Path("a"),)}, "`seeds` is for `flour` wheat, found `flour` rye; rye has none"),
        ({"crust": True}, "`crust` says nothing without `seeds`, expected `seeds` FILE"),
        ({"size": (1.0, -1.0)}, r"`size` is \(1.0, -1.0\), expected a number, 0 or more"),
    ],
    ids=str,
)
def test_what_does_not_fit_is_refused_with_value_and_expectation(values: Any, message: str):
    assert_refused(message, Bake, **values)


def test_two_options_of_which_one_is_expected():
    both = {"flour": "wheat", "seeds": (Path("a"),), "crust": True, "minutes": 5}
    assert_refused("`crust` with `minutes`, expected one of the two", Bake, **both)


@pytest.mark.parametrize(
    ("name", "text", "value"),
    [
        ("minutes", "5", 5),
        ("grams", "5", 5.0),
        ("crust", "Yes", True),
        ("seeds", ["a", "b"], ("in/a", "in/b")),
        ("seeds", "a", ("in/a",)),
        ("size", [1, 2], (1.0, 2.0)),
        ("minutes", None, None),
    ],
    ids=str,
)
def test_a_file_may_hold_the_value_as_text(name: str, text: Any, value: Any):
    assert value_of(named(Bake)[name], text, lambda path: f"in/{path}") == value


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_every_option_has_a_help_and_the_options_that_its_rules_name(kind: type):
    table = declared(kind)
    for name, one in table.items():
        option = one.option
        assert option.help or option.role == "argument", name
        assert {*option.only, *option.needs, *option.excludes} <= set(table), name


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_a_default_fits(kind: type):
    for name, one in declared(kind).items():
        if not one.required and one.default is not None and not one.several:
            assert one.takes(one.default) or one.default in one.option.neutral, name


def test_every_file_that_refine_writes_has_an_option_and_is_written():
    """A path without a role would count as a setting, and one without a writer would be lost."""
    table = declared(RefineOptions)
    roles = {name: entry.option.role for name, entry in table.items() if entry.plain is Path}
    assert {name for name, role in roles.items() if role == "output"} == {"output", *NAMED}
    assert {name for name, role in roles.items() if role == "setting"} == {"prior"}
