"""The index page of a batch's folder, from its journals."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from urllib.parse import quote

from ..batch.journal import ENDS, NAME, entries
from ..io.output import write_file
from ..plots.index_page import COLUMNS, index_page

INDEX, PICTURES = "index.html", "pictures"


def picture_of(output: Path, item: str) -> Path:
    """Where the picture of an item is, in the folder ``output`` of a batch."""
    return output / PICTURES / f"{item}.png"


def write_index(output: Path) -> Path:
    """Write the page of all items of all journals in ``output``, each with its last end."""
    rows: dict[str, dict[str, Any]] = {}
    for journal in sorted(output.glob(f"*{NAME}")):
        for entry in entries(journal):
            if entry["event"] in ENDS:
                rows[entry["item"]] = {key: entry.get(key) for key in COLUMNS}
    for item, row in rows.items():
        if picture_of(output, item).is_file():
            row["picture"] = quote(f"{PICTURES}/{item}.png")
        if (output / item).is_file():
            row["href"] = quote(item)
    path = output / INDEX
    write_file(path, index_page(list(rows.values())).encode(), overwrite=True)
    return path
