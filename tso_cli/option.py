"""Options declared once, as fields of a dataclass.

A field that `opt` makes says what the command line, files of options, manifests and the checks of
its value need. Messages name options in backquotes, which the command line shows as --option.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import MISSING, dataclass, field, fields, replace
from functools import lru_cache
from numbers import Integral, Real
from pathlib import Path
from types import NoneType
from typing import Any, Literal, NamedTuple, get_args, get_origin, get_type_hints

from .errors import InputError

Role = Literal["argument", "setting", "input", "output", "run"]
# An entry of a docstring, "name : what it is", whose next lines are indented further.
_ENTRY = re.compile(r"^ {4}(\w+) : (.*(?:\n {8}.*)*)", re.MULTILINE)
AUTO = "auto"
"""The word that stands for None where a number is expected."""


@dataclass(frozen=True, kw_only=True)
class Option:
    """What a field says of its option.

    role : "argument", or what it says: a "setting" of the method, an "input", an "output", or how
    the command runs ("run").
    default_words : the default in words, where None stands for a value that others decide.
    heading : of this option and those after it in the whole help. brief : whether the short help
    shows it too.
    help, default_words : names of other options stand in backquotes.
    names : on the command line, if they are not the field's. metavar : its value in the help.
    words : that stand in place of a file or a number.
    table : makes the table (value -> meaning) that the word `list` prints.
    parser : the click type of a value that is no word, number or path.
    least, most, above, below : limits of a number; the last two are out of range themselves.
    only : other option -> its values with which this one may be given. why : the reason.
    needs, excludes : the options that this one needs, or excludes.
    neutral : values that ask for nothing, other than the default.
    """

    help: str = ""
    role: Role = "setting"
    default_words: str = ""
    heading: str = ""
    brief: bool = False
    names: tuple[str, ...] = ()
    metavar: str | None = None
    words: tuple[str, ...] = ()
    table: Callable[[], Mapping[str, str]] | None = None
    parser: Any = None
    least: float | None = None
    most: float | None = None
    above: float | None = None
    below: float | None = None
    only: Mapping[str, tuple[Any, ...]] = field(default_factory=dict)
    why: str = ""
    needs: tuple[str, ...] = ()
    excludes: tuple[str, ...] = ()
    neutral: tuple[Any, ...] = ()


def opt(default: Any, default_words: str = "", **more: Any) -> Any:
    """A field of a dataclass that is an option; ``more`` are the fields of `Option`.

    The help is what the docstring of the class says of the field.
    """
    option = Option(default_words=default_words, **more)
    return field(default=default, metadata={"option": option})


class Declared(NamedTuple):
    """A field that is an option: its plain type, whether there are several, what values it takes.

    length : how many numbers are one value. choices : the only values, or ().
    optional : whether None is a value.
    """

    name: str
    option: Option
    default: Any
    plain: type
    several: bool
    length: int
    choices: tuple[str, ...]
    optional: bool

    @property
    def required(self) -> bool:
        return self.default is MISSING

    @property
    def flag(self) -> str:
        """The option on the command line, in full."""
        return max(self.flags, key=len)

    @property
    def flags(self) -> tuple[str, ...]:
        names = self.option.names or (self.name,)
        return tuple(n if n.startswith("-") else f"--{n.replace('_', '-')}" for n in names)

    @property
    def title(self) -> str:
        """The name in messages: of the option, as a parameter."""
        return self.flag.removeprefix("--").replace("-", "_")

    @property
    def expected(self) -> str:
        """The values that it takes, in words."""
        option, plain = self.option, self.plain
        if self.choices:
            return f"one of {', '.join(self.choices)}"
        if plain in (int, float):
            word = "a whole number" if plain is int else "a number"
            word = "a finite number" if option.below == math.inf else word
            return f"{word}{_limits(option)}"
        return {bool: "true or false", Path: "a path"}.get(plain, "text")

    def takes(self, value: Any) -> bool:
        """Whether a value other than None is of the type and within the limits."""
        if self.option.parser is not None:
            return True
        if self.length > 1:
            single = self._replace(length=1)
            return len(value) == self.length and all(map(single.takes, value))
        if self.choices:
            return value in self.choices
        if self.plain in (int, float):
            whole = isinstance(value, Integral if self.plain is int else Real)
            return whole and not isinstance(value, bool) and _is_within(value, self.option)
        return self.plain is not str or isinstance(value, str)


def _is_within(value: Any, option: Option) -> bool:
    return (
        (option.least is None or value >= option.least)
        and (option.most is None or value <= option.most)
        and (option.above is None or value > option.above)
        and (option.below is None or value < option.below)
    )


def _limits(option: Option) -> str:
    if option.most is not None and option.least is not None:
        form = ",d" if isinstance(option.most, int) else "g"
        return f" from {option.least:{form}} to {option.most:{form}}"
    words = [
        "" if option.least is None else f"{option.least:g} or more",
        "" if option.above is None else f"more than {option.above:g}",
        "" if option.most is None else f"at most {option.most:g}",
        "" if option.below in (None, math.inf) else f"less than {option.below:g}",
    ]
    return "".join(f", {word}" for word in words if word)


@lru_cache
def declared(kind: Any) -> dict[str, Declared]:
    """The options of a dataclass by their names, in the order of its fields."""
    hints, helps = get_type_hints(kind), dict[str, str]()
    for base in reversed(kind.__mro__):
        helps |= dict(_ENTRY.findall(base.__doc__ or ""))
    return {
        field.name: described(field.name, hints[field.name], field, helps.get(field.name, ""))
        for field in fields(kind)
        if "option" in field.metadata
    }


def described(name: str, hint: Any, field: Any, help: str = "") -> Declared:
    """The option of a field of a dataclass that `opt` made."""
    arguments = get_args(hint)
    option = field.metadata["option"]
    optional = field.default is None or NoneType in arguments
    option = replace(option, help=option.help or " ".join(help.split()))
    is_tuple = get_origin(hint) is tuple
    several, length = is_tuple and Ellipsis in arguments, 1
    if is_tuple and not several and option.parser is None:
        length = len(arguments)
    if is_tuple or NoneType in arguments:
        hint = Path if Path in arguments else next(a for a in arguments if a is not NoneType)
    choices = get_args(hint) if get_origin(hint) is Literal else ()
    plain = str if choices else hint
    return Declared(name, option, field.default, plain, several, length, choices, optional)


def check(options: Any) -> None:
    """InputError for a value that an option does not take, or for options that do not fit."""
    check_values(options)
    check_rules(options)


def _asked(options: Any) -> Iterator[tuple[Declared, Any]]:
    """Options that ask for something: whose value is not None, the default, or neutral."""
    for name, entry in declared(options.__class__).items():
        value = getattr(options, name)
        if value is not None and value != entry.default and value not in entry.option.neutral:
            yield entry, value


def check_values(options: Any) -> None:
    """InputError for a value that an option does not take."""
    for name, entry in declared(options.__class__).items():
        if getattr(options, name) is None and not entry.optional:
            raise InputError(f"`{entry.title}` is None, expected {entry.expected}")
    for entry, value in _asked(options):
        if not entry.several and not entry.takes(value):
            raise InputError(f"`{entry.title}` is {_shown(value)}, expected {entry.expected}")


def check_rules(options: Any) -> None:
    """InputError for options that do not go together."""
    table = declared(options.__class__)
    for entry, value in _asked(options):
        rules, name = entry.option.only, f"`{entry.title}`"
        if entry.plain is not bool and not entry.several:
            name += f" {value:g}" if isinstance(value, float) else f" {value}"
        if any(getattr(options, other) not in allowed for other, allowed in rules.items()):
            conditions = [f"`{table[o].title}` {_either(values)}" for o, values in rules.items()]
            present = [_present(table[other].title, getattr(options, other)) for other in rules]
            why = entry.option.why and f"; {entry.option.why}"
            raise InputError(
                f"{name} is for {' and '.join(conditions)}, found {' and '.join(present)}{why}"
            )
        for other in entry.option.needs:
            if not getattr(options, other):
                needed = f"`{table[other].title}`"
                file = " FILE" if table[other].plain is Path else ""
                raise InputError(f"{name} says nothing without {needed}, expected {needed}{file}")
        for other in entry.option.excludes:
            if getattr(options, other) not in (None, False, 0, ()):
                raise InputError(
                    f"`{entry.title}` with `{table[other].title}`, expected one of the two"
                )


def _present(title: str, value: Any) -> str:
    return f"no `{title}`" if value is None else f"`{title}` {value}"


def _either(values: tuple[Any, ...]) -> str:
    *first, last = (str(value) for value in values if value is not None)
    return f"{', '.join(first)} or {last}" if first else last


def _shown(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else repr(value)
