"""`tso lab`: a command for each question."""

from __future__ import annotations

import click

from ...commands.lazy_group import LazyGroup
from ..studies import QUESTIONS

TOOLS = {
    "page": ("tso_cli.lab.commands.page", "Write the pages and charts of records anew, running nothing."),
    "fingerprint": ("tso_cli.lab.commands.fingerprint", "Whether records are of the method as it is."),
    "generate": ("tso_cli.lab.commands.generate", "Draw chairs, cars and aeroplanes by rule, to train on."),
}
STUDIES = {name: (f"tso_cli.lab.studies.{module}", question) for name, (module, question) in QUESTIONS.items()}


class _Lab(LazyGroup):
    """Studies have one command for all of them."""

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in QUESTIONS:
            return super().get_command(ctx, cmd_name)
        from .page import load
        from .study import command_of

        return command_of(load(cmd_name))


@click.group("lab", cls=_Lab, sections={"Studies": STUDIES, "Tools": TOOLS})
def command() -> None:
    """Ask a question of the method, on many shapes, and keep the answer as JSON beside a chart and a page."""
