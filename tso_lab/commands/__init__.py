"""`tso lab`: a command for each question."""

from __future__ import annotations

import click

from tso_cli.commands.options import LazyGroup

from ..studies import WORDS

TOOLS = {
    "records": "Make the records again that are due.",
    "page": "Write the pages and charts of records again, without running anything.",
    "fingerprint": "Whether records were made by the method as it is.",
}


class StudyGroup(LazyGroup):
    """All studies share one command, and the tools are in one module."""

    def load(self, name: str) -> click.Command:
        from . import tools
        from .records import command_of

        command: click.Command = (
            getattr(tools, name) if name in TOOLS else command_of(tools.load(name))
        )
        return command


LINES = {
    "Studies": {name: ("", words["question"]) for name, words in WORDS.items()},
    "Tools": {name: ("", text) for name, text in TOOLS.items()},
}


@click.group("lab", cls=StudyGroup, sections=LINES)
def command() -> None:
    """Ask a question of the method; keep the answer as JSON, with a chart and a page."""
