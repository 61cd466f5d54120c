"""Command lines, and what becomes of their options: parsed, checked and hashed, or refused.

python -m tests.pinned_options options.json            writes them
python -m tests.pinned_options options.json --check    compares with those, names what differs

Every option of the commands stands in lines of its own, with values that fit and values that do
not, and every two options of `tso refine` stand together once. The file is made before a change of
the code, and thrown away after it. Words may change. What is refused, and what a run is called,
may not.
"""

import itertools
import json
import sys
from pathlib import Path
from typing import Any

import click

from tso_cli.cli import tso
from tso_cli.commands import options
from tso_cli.commands.refine.options import RefineOptions
from tso_cli.commands.refine.record import key_of
from tso_cli.errors import TsoError

REFINE = ["examples/chair/initial.ply", "examples/chair/mask.png"]
ARGUMENTS = {"refine": REFINE, "batch": ["examples"], "eval": REFINE, "render": ["examples"]}


def values_of(parameter: click.Parameter) -> list[list[str]]:
    """Words that may follow an option: some that fit, and some that do not."""
    if getattr(parameter, "is_flag", False):
        return [[]]
    if isinstance(parameter.type, click.Choice):
        return [[str(choice)] for choice in parameter.type.choices] + [["other"]]
    words = ["1", "0", "-1", "0.5", "nan", "auto", "none", "a.png", "a.json", "4,5"]
    return [[word] * parameter.nargs for word in words]


def flag(parameter: click.Parameter) -> str:
    return max(parameter.opts, key=len)


def lines() -> dict[str, list[str]]:
    """Name -> words of a command line."""
    found = {}
    context = click.Context(tso)
    for name in tso.list_commands(context):
        command = tso.get_command(context, name)
        assert command is not None
        of_command = [
            parameter
            for parameter in command.params
            if isinstance(parameter, click.Option) and not parameter.is_eager
        ]
        of_command.sort(key=flag)
        for parameter in of_command:
            for values in values_of(parameter):
                words = [name, *ARGUMENTS.get(name, []), flag(parameter), *values]
                found[" ".join(words)] = words
        if name == "refine":
            for one, other in itertools.combinations(of_command, 2):
                pair = [flag(one), *values_of(one)[0], flag(other), *values_of(other)[0]]
                found[" ".join(["refine", *pair])] = ["refine", *REFINE, *pair]
    return found


def outcome(words: list[str]) -> str:
    """The key of the options, or the kind of error."""
    name, *arguments = words
    context = click.Context(tso)
    command = tso.get_command(context, name)
    assert command is not None
    try:
        with command.make_context(name, list(arguments), parent=context) as ctx:
            given = options.explicit_options(ctx)
            if name == "refine":
                RefineOptions(**ctx.params)
            texts: dict[str, Any] = {key: str(value) for key, value in given.items()}
            key = f"{key_of(given, [])[:12]} " if name == "refine" else ""
            return f"{key}{json.dumps(texts, sort_keys=True)}"
    except (click.ClickException, TsoError):
        return "refused"
    except click.exceptions.Exit as error:
        return f"exit {error.exit_code}"


def main(arguments: list[str]) -> int:
    file = Path(arguments[0])
    now = {name: outcome(words) for name, words in lines().items()}
    if "--check" not in arguments:
        file.write_text(json.dumps(now, indent=1))
        refused = sum(text.startswith("refused") for text in now.values())
        print(f"{len(now)} command lines, {refused} refused")
        return 0
    before = json.loads(file.read_text())
    changed = [name for name in sorted(before | now) if before.get(name) != now.get(name)]
    for name in changed:
        print(f"{name}\n  {before.get(name)}\n  {now.get(name)}")
    print(f"{len(changed)} of {len(now)} differ")
    return 1 if changed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
