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


class StudyGroup(LazyGroup):
    """Studies have one command for all of them, and the tools are in one module."""

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in self.list_commands(ctx):
            return None
        from . import tools
        from .records import command_of

        command: click.Command = (
            getattr(tools, cmd_name) if cmd_name in TOOLS else command_of(tools.load(cmd_name))
        )
        return command


def lines(questions: dict[str, tuple[str, str]]) -> dict[str, tuple[str, str]]:
    """The section of a group with these studies."""
    return {name: ("", question) for name, (_, question) in questions.items()}


@click.group(
    "lab",
    cls=StudyGroup,
    sections={
        "Studies": lines(QUESTIONS),
        "Tools": {name: ("", text) for name, text in TOOLS.items()},
    },
)
def command() -> None:
    """Ask a question of the method, on many shapes, and keep the answer as JSON beside a chart and a page."""
