"""The pages are written for a reader who sees them for the first time."""

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.readme import DOCS, PAGES, README, ROOT

WRITTEN = (*PAGES, ROOT / "CHANGELOG.md", ROOT / "examples" / "README.md")
# What a newcomer reads before the first result of their own.
NEWCOMERS_WORDS = 2750
LONGEST_SENTENCE = 35
LONGEST_LINE = 120
# Words of our own making, and constructions that need a second reading.
BANNED = re.compile(
    r"\b(strays?(?! Scanner)|so many|so much|but for|of which|the same of|judged|told|tells|borne|"
    r"beside)\b",
    re.IGNORECASE,
)

CODE_BLOCK = re.compile(r"^```.*?^```$", re.MULTILINE | re.DOTALL)
NOT_PROSE = re.compile(r"(\||#|!\[|<!--|    )")
LIST_ITEM = re.compile(r"^\s*(?:[-*]|\d+\.)\s+")
END_OF_SENTENCE = re.compile(r"(?<=[.!?])\s+")


def without_code(text: str) -> str:
    """``text`` with code blocks emptied, their lines kept, so that line numbers stay right."""
    return CODE_BLOCK.sub(lambda block: "\n" * block[0].count("\n"), text)


def is_prose(line: str) -> bool:
    """Not a table, heading, picture, marker or indented formula."""
    return not NOT_PROSE.match(line) or bool(LIST_ITEM.match(line))


def paragraphs(text: str) -> Iterator[str]:
    """Paragraphs and list items, each on one line; a link is its text, inline code one word."""
    paragraph: list[str] = []
    for line in [*without_code(text).splitlines(), ""]:
        starts_new = not line.strip() or not is_prose(line) or LIST_ITEM.match(line)
        if starts_new and paragraph:
            plain = re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", " ".join(paragraph))
            yield re.sub(r"`[^`]*`", "code", plain)
            paragraph = []
        if line.strip() and is_prose(line):
            paragraph.append(LIST_ITEM.sub("", line).strip())


def sentences(text: str) -> Iterator[str]:
    for paragraph in paragraphs(text):
        yield from END_OF_SENTENCE.split(paragraph)


def test_sentences_end_at_full_stops_and_code_and_tables_are_left_out():
    text = "One two\nthree. [Four](five.md) `six seven`!\n\n| a | b. |\n- Eight.\n```\nnine\n```\n"
    assert list(sentences(text)) == ["One two three.", "Four code!", "Eight."]


def test_what_a_newcomer_reads_is_short():
    words = sum(len(page.read_text().split()) for page in (README, DOCS / "quickstart.md"))
    assert words <= NEWCOMERS_WORDS


@pytest.mark.parametrize("page", WRITTEN, ids=lambda page: page.name)
def test_no_sentence_is_long(page: Path):
    too_long = [
        f"{len(sentence.split())} words: {sentence}"
        for sentence in sentences(page.read_text())
        if len(sentence.split()) > LONGEST_SENTENCE
    ]
    assert not too_long, "\n".join(too_long)


@pytest.mark.parametrize("page", WRITTEN, ids=lambda page: page.name)
def test_no_banned_word_is_used(page: Path):
    found = []
    for number, line in enumerate(without_code(page.read_text()).splitlines(), 1):
        plain = re.sub(r"`[^`]*`", "", line)
        found += [f"{page.name}:{number}: {match[0]}" for match in BANNED.finditer(plain)]
    assert not found, "\n".join(found)


def test_the_code_speaks_as_the_pages_do():
    """Names of JSON keys may keep an old word; comments, docstrings and messages may not."""
    found = []
    for path in sorted((ROOT / "tso_cli").rglob("*.py")):
        if "lab" not in path.parts:
            for number, line in enumerate(path.read_text().splitlines(), 1):
                prose = re.sub(r"[\"'](\w+)[\"'](?=[:\]])", "", line)
                found += [f"{path.name}:{number}: {match[0]}" for match in BANNED.finditer(prose)]
    assert found == []


@pytest.mark.parametrize("page", WRITTEN, ids=lambda page: page.name)
def test_lines_fit_into_a_terminal(page: Path):
    lines = without_code(page.read_text()).splitlines()
    too_long = [line for line in lines if len(line) > LONGEST_LINE and not line.startswith("|")]
    assert not too_long, "\n".join(too_long)
