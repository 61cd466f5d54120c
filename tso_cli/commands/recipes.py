"""Recipes: files of the options of `tso train`, such as those that the shipped weights have."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from ..errors import InputError
from . import options

RECIPES = ("network", "prior")
"""Words for the recipes of the shipped weights."""
RECIPE = "tso.recipe"
"""Key of a context's ``meta``: the `Recipe` that --config names."""
EXPECTED = "a .toml or .json file of options, or one of the words network and prior"


@dataclass(frozen=True)
class Recipe:
    """A file of options.

    name : its name and the first digits of its SHA-256.
    render : options of `tso render`, if the data are rendered first.
    """

    path: Path
    name: str
    render: dict[str, Any] | None


def read_recipe(ctx: click.Context, parameter: click.Parameter, path: Path | None) -> None:
    """Let the options of a recipe stand for those that are not given."""
    if path is None:
        return
    from ..io.reading import shown
    from ..io.shipped import PACKAGE
    from .option_files import read_options, set_defaults
    from .refine_record import digest_of

    if str(path) in RECIPES:
        path = PACKAGE / "recipes" / f"{path}.toml"
    document = read_options(path, EXPECTED)
    table = document.pop("render", None)
    if table is not None and not isinstance(table, dict):
        raise InputError(f"{path}: render is {shown(table)}, expected a table of options")
    set_defaults(ctx, path, document)
    ctx.meta[options.CONFIG] = path
    ctx.meta[RECIPE] = Recipe(path, f"{path.name} {digest_of(path)[:16]}", table)


def render(recipe: Recipe, meshes: Path | None, output: Path) -> Path:
    """Render ``meshes`` as a recipe says; the folder of the pictures is next to the ``output``.

    What is rendered already is kept.
    """
    from .option_files import set_defaults
    from .render import command

    folder = output.with_name(f"{output.stem}.rendered")
    given = [str(meshes)] if meshes is not None else []
    defaults = click.Context(command, info_name="render")
    set_defaults(defaults, recipe.path, recipe.render or {})
    with command.make_context(
        "render", [*given, "-o", str(folder)], default_map=defaults.default_map
    ) as ctx:
        command.invoke(ctx)
    return folder
