"""The help of every command: complete, short, true, and the same with every version of click."""

import re
import subprocess
import sys
import warnings
from pathlib import Path

import click
import pytest

import tso_cli
from tso_cli.cli import SECTIONS, with_options
from tso_cli.cli import tso as root
from tso_cli.commands.options import Warnings, listing
from tso_cli.commands.train.options import EXAMPLE_DEFAULTS, TrainOptions

PRODUCT = [name for heading, names in SECTIONS.items() if heading != "Research" for name in names]
RESEARCH = list(SECTIONS["Research"])


def commands(group=root, words=()):
    """The words of every command that is not a group."""
    context = click.Context(group)
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        if isinstance(command, click.Group):
            yield from commands(command, (*words, name))
        else:
            yield (*words, name)


@pytest.fixture
def narrow(monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")


@pytest.mark.parametrize("words", [(), *((name,) for name in RESEARCH)], ids=str)
def test_a_group_without_a_command_prints_its_help_on_lines_and_exits_with_2(tso, words):
    bare, asked = tso(*words), tso(*words, "--help")
    assert bare.code == 2
    assert bare.out == ""
    assert asked.code == 0
    assert bare.err == asked.out
    assert bare.err.startswith("Usage: tso")
    assert len(bare.err.splitlines()) > 10


def test_studies_and_benchmarks_are_one_line_at_the_end_of_the_help(tso):
    *_, heading, last = tso("--help").out.splitlines()
    assert heading == "Research:"
    assert re.fullmatch(r"  lab +Studies and benchmarks of the method\.", last)


WITHOUT_LAB = """
import sys
from pathlib import Path
sys.path = [*(place for place in sys.path if not Path(place, "tso_lab").exists()), sys.argv[1]]
from tso_cli.cli import main
main(sys.argv[2:])
"""


def test_the_laboratory_is_no_command_where_only_the_product_is_installed(tmp_path):
    (tmp_path / "tso_cli").symlink_to(Path(tso_cli.__file__).parent)

    def run(*words):
        line = [sys.executable, "-c", WITHOUT_LAB, tmp_path, *words]
        return subprocess.run(line, cwd=tmp_path, capture_output=True, text=True)

    assert "Research" not in run("--help").stdout
    assert "No such command 'lab'" in run("lab").stderr


def test_every_command_has_its_line_in_the_help(tso):
    lines = tso("--help").out.splitlines()
    for section in SECTIONS.values():
        for name, (_, text) in section.items():
            assert any(re.fullmatch(rf"  {name} +{re.escape(text)}", line) for line in lines)


def test_every_command_has_help_all_which_shows_every_option(tso):
    for words in commands():
        context = click.Context(root)
        command = root
        for word in words:
            command = command.get_command(context, word)
        shown = tso(*words, "--help-all").out
        for parameter in command.params:
            if isinstance(parameter, click.Option) and not parameter.hidden:
                assert re.search(rf"{parameter.opts[-1]}\b", shown), (words, parameter.name)


def test_help_names_help_all_where_it_shows_less(tso):
    for words in commands():
        brief, whole = (tso(*words, option).out for option in ("--help", "--help-all"))
        assert (brief != whole) == ("--help-all" in brief)
        assert "-h, --help" in brief


def test_a_help_fits_on_80_columns_and_60_lines(tso, narrow):
    for words in [(), *commands()]:
        lines = tso(*words, "--help").out.splitlines()
        assert max(map(len, lines)) <= 80, words
        assert len(lines) <= 60, words


@pytest.mark.parametrize("option", ["--help", "--help-all"])
def test_no_help_shows_bounds_that_say_nothing(tso, option):
    for name in PRODUCT:
        shown = tso(name, option).out
        assert str(2**63 - 1) not in shown
        assert not re.search(r"\bINTEGER\b|\bFLOAT\b|\bRANGE\b", shown), name


def test_the_defaults_in_the_help_of_train_are_the_ones_used(tso):
    shown = " ".join(tso("train", "--help-all").out.split())
    for name, value in EXAMPLE_DEFAULTS.items():
        assert f"[default: {getattr(TrainOptions, name):g}; {value:g} without DATA" in shown


def test_the_help_is_in_plain_english(tso):
    private = r"\b(stray|so many|so much|but for|of which|the same of|judged|told|borne|tells)\b"
    for name in PRODUCT:
        assert not re.search(private, tso(name, "--help-all").out, re.IGNORECASE), name


def test_an_option_can_list_its_values_without_the_arguments_of_the_command(capsys):
    table = {"opengl": "the camera's axes are OpenGL's", "mask-inverted": "the mask is inverted"}

    @click.command()
    @click.argument("source")
    @click.option("--assume", multiple=True, is_eager=True, callback=listing(lambda: table))
    def command(source, assume):
        click.echo(f"{source} {assume}")

    assert command.main(["--assume", "list"], standalone_mode=False) == 0
    assert capsys.readouterr().out.splitlines() == [
        "opengl         the camera's axes are OpenGL's",
        "mask-inverted  the mask is inverted",
    ]
    command.main(["x.ply", "--assume", "opengl"], standalone_mode=False)
    assert capsys.readouterr().out == "x.ply ('opengl',)\n"


@pytest.mark.parametrize("quiet", [False, True])
def test_warnings_are_kept_in_order_and_printed_unless_quiet(monkeypatch, quiet):
    printed = []
    monkeypatch.setattr(warnings, "showwarning", lambda message, *_, **__: printed.append(message))
    before = warnings.showwarning
    with warnings.catch_warnings(), Warnings(quiet) as warned:
        warnings.simplefilter("always")
        warnings.warn("first", stacklevel=1)
        warnings.warn("second", stacklevel=1)
    assert warned.texts == ["first", "second"]
    assert [str(message) for message in printed] == ([] if quiet else ["first", "second"])
    assert warnings.showwarning is before


@pytest.mark.parametrize(
    ("message", "shown"),
    [
        ("a.ply: exists already, expected a new name or `overwrite`", "a new name or --overwrite"),
        ("`sigma_sq` is 0, expected more", "--sigma-sq is 0, expected more"),
        ("see `tso eval --help`", "see `tso eval --help`"),
    ],
)
def test_errors_show_the_parameters_of_the_library_as_options(message, shown):
    assert shown in with_options(message)
