"""`tso lab`: a command for each question."""

from __future__ import annotations

import click

from ...commands.options import LazyGroup
from ..studies import QUESTIONS

TOOLS = {
    "page": "Write the pages and charts of records anew, running nothing.",
    "fingerprint": "Whether records are of the method as it is.",
    "generate": "Draw chairs, cars and aeroplanes by rule, to train on.",
}
SECTIONS = {
    "Studies": {name: ("", question) for name, (_, question) in QUESTIONS.items()},
    "Tools": {name: ("", text) for name, text in TOOLS.items()},
}


class _Lab(LazyGroup):
    """The tools are in one module, and studies have one command for all of them."""

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        from . import tools
        from .records import command_of

        if cmd_name in QUESTIONS:
            return command_of(tools.load(cmd_name))
        command: click.Command | None = getattr(tools, cmd_name) if cmd_name in TOOLS else None
        return command


@click.group("lab", cls=_Lab, sections=SECTIONS)
def command() -> None:
    """Ask a question of the method, on many shapes, and keep the answer as JSON beside a chart and a page."""
