"""Recipes: files of the options of `tso train`, such as those that the shipped weights have."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from ...errors import InputError
from .. import options

RECIPE = "tso.recipe"
"""Key of a context's ``meta``: the `Recipe` that --config names."""


@dataclass(frozen=True)
class Recipe:
    """A file of options.

    name : its name and the first digits of its SHA-256.
    render : options of `tso render`, if the data are rendered first.
    """

    path: Path
    name: str
    render: dict[str, Any] | None


def recipe_option(word: str, kind: type) -> click.Option:
    """The option --config of a training with the options of ``kind``; ``word`` is shipped."""

    def read(ctx: click.Context, parameter: click.Parameter, path: Path | None) -> None:
        if path is not None:
            _read_recipe(ctx, kind, word, path)

    return click.Option(
        ["--config"],
        type=options.FilePath(word),
        is_eager=True,
        expose_value=False,
        callback=read,
        metavar=f"{word}|FILE",
        help=f"Options from a file, unless they are given here: TOML or JSON. `{word}` is the "
        "recipe of the shipped weights.",
    )


def _read_recipe(ctx: click.Context, kind: type, word: str, path: Path) -> None:
    """Let the options of a recipe stand for those that are not given."""
    from ...io.reading import digest_of, shown
    from ...io.shipped import PACKAGE
    from ..option_files import read_options, set_defaults

    if str(path) == word:
        path = PACKAGE / "recipes" / f"{path}.toml"
    document = read_options(path, f"a .toml or .json file of options, or the word {word}")
    table = document.pop("render", None)
    if table is not None and not isinstance(table, dict):
        raise InputError(f"{path}: render is {shown(table)}, expected a table of options")
    set_defaults(ctx, kind, path, document)
    ctx.meta[options.CONFIG] = path
    ctx.meta[RECIPE] = Recipe(path, f"{path.name} {digest_of(path)[:16]}", table)


def render(recipe: Recipe, meshes: Path | None, output: Path) -> Path:
    """Render ``meshes`` as a recipe says; the folder of the pictures is next to the ``output``.

    What is rendered already is kept.
    """
    from ..option_files import values_of
    from ..render import RenderOptions, render_meshes

    folder = output.with_name(f"{output.stem}.rendered")
    values = values_of(RenderOptions, "render", recipe.path, recipe.render or {})
    if values.get("split"):
        values["split"] = Path(values["split"])
    render_meshes(RenderOptions(**{**values, "source": meshes, "output": folder}))
    return folder
