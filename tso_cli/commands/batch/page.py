"""The index page of a batch's folder, from its journals."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any
from urllib.parse import quote

from ...batch.journal import NAME, read_journals
from ...io.output import write_file
from ...io.reading import is_there
from ...plots.index_page import COLUMNS, index_page
from ..refine.outputs import record_of

INDEX, PICTURES = "index.html", "pictures"
NO_PICTURES = (
    "There are no pictures: a picture is made when an item is refined with --report. Run the batch "
    "with --report in a new folder."
)


def picture_of(output: Path, item: str) -> Path:
    """Where the picture of an item is, in the folder ``output`` of a batch."""
    return output / PICTURES / f"{item}.png"


def write_index(output: Path) -> Path:
    """Write the page of all items of all journals in ``output``, each with its last end."""
    past = read_journals(sorted(output.glob(f"*{NAME}")))
    path = output / INDEX
    rows = [_row(output, item.end) for item in past.values() if item.end]
    page = index_page(rows, NO_PICTURES)
    write_file(path, page.encode(errors="replace"), overwrite=True)
    return path


def _row(output: Path, entry: dict[str, Any]) -> dict[str, Any]:
    """What the page shows of an item's end, with its picture and a link to its page or file."""
    item = entry["item"]
    row = {key: entry.get(key) for key in COLUMNS}
    row["columns"] = entry.get("columns", {})
    if is_there(picture_of(output, item)):
        row["picture"] = quote(f"{PICTURES}/{item}.png")
    if is_there(output / item):
        row["href"] = quote(_page_of(output, item) or item)
    return row


def _page_of(output: Path, item: str) -> str | None:
    """The page of an item, relative to the folder; None unless its record names one."""
    record = Path(record_of(str(output / item)))
    try:
        page = json.loads(record.read_bytes())["options"]["report"]
        path = os.path.normpath(Path(item).parent / page)
        return Path(path).as_posix() if (output / path).is_file() else None
    except (OSError, ValueError, KeyError, TypeError):  # no record, or not one of tso's
        return None
