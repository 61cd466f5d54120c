"""The page of a batch: a table of all items, with pictures, to sort and to search."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from typing import Any

from .page.write import as_json, html_page, text

COLUMNS = {
    "item": "item",
    "event": "result",
    "confidence": "confidence",
    "iou_before": "IoU before",
    "iou_after": "IoU after",
    "seconds": "seconds",
    "reason": "why",
}
NUMBERS = ("confidence", "iou_before", "iou_after", "seconds")
WORST_FIRST = ("failed", "refused", "doubtful", "done")
ROWS = 200  # that are drawn at once
SHOWN = (
    "The pictures show mask and silhouette, before and after: what both have is grey, what is "
    "missing blue, what is extra orange."
)
_STYLE = """
:root{color-scheme:light dark}
body{font:15px/1.4 system-ui,sans-serif;margin:1.5rem auto;max-width:75rem;padding:0 1rem}
table{border-collapse:collapse;width:100%}
th,td{text-align:left;padding:.35rem .6rem;border-bottom:1px solid #8884;vertical-align:middle}
th button{font:inherit;font-weight:600;border:0;background:none;padding:0;cursor:pointer;
color:inherit;text-align:left}
th[aria-sort] button::after{content:" \\25BC"}
th[aria-sort=ascending] button::after{content:" \\25B2"}
th button{white-space:nowrap}
.number,.number button{text-align:right;font-variant-numeric:tabular-nums}
td img{display:block;background:#fff;max-width:196px}
td.name,td.why{overflow-wrap:anywhere}td.name{min-width:11rem}
.bar{display:flex;gap:.75rem;flex-wrap:wrap;align-items:center;margin:1rem 0}
input,select,.bar button{font:inherit;padding:.25rem .5rem}
@media(max-width:45rem){thead{display:none}tr{display:block;border-bottom:1px solid #8886;
padding:.5rem 0}td:empty{display:none!important}
td,td.number{display:block;border:0;text-align:left;padding:.1rem 0}
td[data-name]:not(.name)::before{content:attr(data-name)": ";opacity:.7}}
"""
_SCRIPT = """
"use strict";
const data = JSON.parse(document.getElementById("rows").textContent);
const columns = data.columns, body = document.querySelector("tbody");
const search = document.getElementById("search"), only = document.getElementById("only");
const more = document.getElementById("more"), count = document.getElementById("count");
let by = "event", up = true, shown = data.rowsAtOnce;
const numbers = new Set(data.numbers);
const none = v => v === null || v === undefined || v === "";

function compared(a, b, key, way) {
  const x = a[key], y = b[key];
  if (none(x) || none(y)) return none(x) - none(y);
  if (numbers.has(key)) return way * (x - y);
  if (key === "event") return way * (data.worstFirst.indexOf(x) - data.worstFirst.indexOf(y));
  return way * String(x).localeCompare(String(y), undefined, {numeric: true});
}
const order = (a, b) => compared(a, b, by, up ? 1 : -1) || compared(a, b, "confidence", 1);

function draw() {
  const words = search.value.toLowerCase();
  const rows = data.rows.filter(row => (!only.value || row.event === only.value)
    && (!words || Object.keys(columns).filter(key => !numbers.has(key))
      .map(key => row[key] ?? "").join(" ").toLowerCase().includes(words)));
  rows.sort(order);
  body.replaceChildren(...rows.slice(0, shown).map(row => {
    const line = document.createElement("tr"), picture = data.pictures ? line.insertCell() : null;
    if (row.picture) {
      const image = document.createElement("img");
      image.loading = "lazy"; image.width = 196; image.height = 96;
      image.src = row.picture; image.alt = "mask and silhouette, before and after";
      picture.append(image);
    }
    for (const key of Object.keys(columns)) {
      const cell = line.insertCell(), value = row[key];
      cell.dataset.name = columns[key];
      cell.className = numbers.has(key) ? "number" : key === "item" ? "name" : "why";
      const digits = key === "seconds" ? 2 : 3;
      const shownValue = value === null || value === undefined ? ""
        : numbers.has(key) ? value.toFixed(digits) : value;
      if (key === "item" && row.href) {
        const link = document.createElement("a");
        link.href = row.href; link.textContent = shownValue; cell.append(link);
      } else cell.textContent = shownValue;
    }
    return line;
  }));
  count.textContent = rows.length.toLocaleString("en") + " items";
  more.hidden = rows.length <= shown;
  for (const head of document.querySelectorAll("th[data-key]"))
    if (head.dataset.key === by) head.setAttribute("aria-sort", up ? "ascending" : "descending");
    else head.removeAttribute("aria-sort");
}

for (const head of document.querySelectorAll("th[data-key]"))
  head.querySelector("button").addEventListener("click", () => {
    up = by === head.dataset.key ? !up : true;
    by = head.dataset.key;
    draw();
  });
search.addEventListener("input", draw);
only.addEventListener("change", draw);
more.addEventListener("click", () => { shown += data.rowsAtOnce; draw(); });
draw();
"""


def index_page(rows: Sequence[dict[str, Any]], no_pictures: str) -> str:
    """The page of items; each row has the keys of `COLUMNS`, and perhaps picture and href.

    ``no_pictures`` : what to say where no row has a picture. ``columns`` of a row has more of its
    item, by the names that the page gives them.
    """
    more = dict.fromkeys(name for row in rows for name in row.get("columns", {}))
    # No name of a user is one of this page's.
    columns = COLUMNS | {f"columns {name}": name for name in more}
    rows = [
        {key: value for key, value in row.items() if key != "columns"}
        | {
            f"columns {name}": value if isinstance(value, str) else json.dumps(value)
            for name, value in row.get("columns", {}).items()
        }
        for row in rows
    ]
    counts = Counter(str(row["event"]) for row in rows)
    heads = "".join(
        f'<th data-key="{key}"{" class=number" if key in NUMBERS else ""}>'
        f"<button>{text(name)}</button></th>"
        for key, name in columns.items()
    )
    choices = "".join(f"<option>{text(event)}</option>" for event in sorted(counts))
    summary = ", ".join(f"{number:,} {text(event)}" for event, number in counts.most_common())
    pictures = any("picture" in row for row in rows)
    head = f"<tr>{'<th>picture</th>' if pictures else ''}{heads}</tr>"
    data = {
        "columns": columns,
        "numbers": NUMBERS,
        "rows": rows,
        "rowsAtOnce": ROWS,
        "worstFirst": WORST_FIRST,
        "pictures": pictures,
    }
    body = (
        f"<h1>{len(rows):,} items</h1>\n<p>{summary}. {SHOWN if pictures else no_pictures}</p>\n"
        '<div class="bar"><input id="search" type="search" placeholder="search" '
        'aria-label="search items"><select id="only" aria-label="show only">'
        f'<option value="">all</option>{choices}</select><span id="count"></span></div>\n'
        f"<table><thead>{head}</thead><tbody></tbody></table>\n"
        '<p><button id="more">more</button></p>\n'
        f'<script type="application/json" id="rows">{as_json(data)}</script>\n'
    )
    title = f"{len(rows):,} items: tso batch"
    return html_page(title, _STYLE, body, [_SCRIPT], images="'self' file: data:")
