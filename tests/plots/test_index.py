"""The index page of a batch: what it says of each item, in which order, and where it leads."""

import json
from pathlib import Path

import pytest

from tso_cli.commands.batch.page import write_index

from .browser import CHROMIUM, Browser

needs_chromium = pytest.mark.skipif(CHROMIUM is None, reason="there is no chromium")


def journal(name, *ends):
    """A journal with lines (item, event, time, confidence)."""
    keys = ("item", "event", "time", "confidence")
    lines = [json.dumps(dict(zip(keys, end, strict=True))) for end in ends]
    Path(name).write_text("\n".join(lines) + "\n")


def result(item, report=None):
    """The file of an item and its record; ``report`` : the page, as the record names it."""
    path = Path(item)
    path.parent.mkdir(exist_ok=True)
    path.write_text("a cloud")
    options = {} if report is None else {"report": report}
    path.with_suffix(".record.json").write_text(json.dumps({"options": options}))


@pytest.fixture
def page(tmp_path, monkeypatch):
    """The text of the index page of the working directory, and its rows by their item."""
    monkeypatch.chdir(tmp_path)

    def read():
        text = write_index(Path()).read_text()
        data = text.partition('id="rows">')[2].partition("</script>")[0]
        return text, {row["item"]: row for row in json.loads(data)["rows"]}

    return read


def test_of_several_journals_the_latest_end_of_an_item_counts(page):
    journal("1-of-2.journal.jsonl", ("b.ply", "failed", 5.0, None), ("a.ply", "done", 20.0, 0.9))
    journal("journal.jsonl", ("b.ply", "done", 6.0, 0.8), ("a.ply", "failed", 10.0, None))
    events = {item: row["event"] for item, row in page()[1].items()}
    assert events == {"a.ply": "done", "b.ply": "done"}


def test_an_item_leads_to_its_page_if_it_has_one_and_else_to_its_file(page):
    result("in/a b.ply", report="a b.html")
    Path("in/a b.html").write_text("a page")
    result("gone.ply", report="gone.html")
    result("plain.ply")
    Path("bare.ply").write_text("a cloud without a record")
    names = ("in/a b.ply", "gone.ply", "plain.ply", "bare.ply", "refused.ply")
    journal("journal.jsonl", *((name, "done", 1.0, 0.9) for name in names))
    rows = page()[1]
    assert [rows[name].get("href") for name in names] == [
        "in/a%20b.html", "gone.ply", "plain.ply", "bare.ply", None,
    ]  # fmt: skip


def test_without_any_picture_the_page_has_no_column_of_pictures_and_says_how_to_get_them(page):
    journal("journal.jsonl", ("a.ply", "done", 1.0, 0.9))
    text, _ = page()
    assert "<th>picture</th>" not in text
    assert "The pictures show" not in text
    assert "Run the batch with --report in a new folder." in text
    Path("pictures").mkdir()
    Path("pictures/a.ply.png").write_text("a picture")
    text, _ = page()
    assert "<th>picture</th>" in text
    assert "The pictures show" in text


@needs_chromium
def test_the_worst_comes_first(page, tmp_path):
    journal(
        "journal.jsonl",
        ("sure", "done", 1.0, 0.9),
        ("refused", "refused", 1.0, None),
        ("doubtful", "doubtful", 1.0, 0.4),
        ("none", "done", 1.0, None),
        ("unsure", "done", 1.0, 0.6),
        ("failed", "failed", 1.0, None),
        ("worse", "doubtful", 1.0, 0.1),
    )
    page()
    with Browser(tmp_path / "chromium") as browser:
        browser.open(Path("index.html"), 1200, ready=False)
        names = "[...document.querySelectorAll('td.name')].map(cell => cell.textContent)"
        worst_first = ["failed", "refused", "worse", "doubtful", "unsure", "sure", "none"]
        assert browser.run(names) == worst_first
        browser.run("document.querySelector('[data-key=confidence] button').click()")
        assert browser.run(names)[:2] == ["worse", "doubtful"]
        assert browser.errors == []
