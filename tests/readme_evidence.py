"""The tables of docs/method.md, from the kept records of `tso lab evidence` and `tso lab pose`."""

from __future__ import annotations

# Questions whose categories are told apart; of the others all cases together.
BY_CATEGORY = ("depth",)


def evidence_tables(record: dict) -> dict[str, str]:
    """Question -> Markdown: mean Chamfer after / before and worst case, a row a way of refining."""
    return {name: _table(kinds, name in BY_CATEGORY) for name, kinds in record["summary"].items()}


def _table(kinds: dict, by_category: bool) -> str:
    columns = [
        (kind, category, rows)
        for kind, categories in kinds.items()
        for category, rows in categories.items()
        if (category != "all") == by_category
    ]
    names = list(dict.fromkeys(name for _, _, rows in columns for name in rows))
    header = [_heading(kind, category, rows, by_category) for kind, category, rows in columns]
    lines = [["", *header], ["---"] * (len(columns) + 1)]
    lines += [[name, *(_cell(rows.get(name)) for _, _, rows in columns)] for name in names]
    return "\n".join("| " + " | ".join(line) + " |" if line[0] else "| | " + " | ".join(line[1:]) + " |" for line in lines)


def _heading(kind: str, category: str, rows: dict, by_category: bool) -> str:
    if by_category:
        return category if kind == "other" else f"{category}, {kind}"
    return f"{kind}, {next(iter(rows.values()))['cases']} cases"


def _cell(own: dict | None) -> str:
    if own is None:
        return ""
    told = [f"{key} {value:.2f}" for key, value in own.items() if key not in ("cases", "mean_ratio", "worst_ratio", "worse")]
    return ", ".join([f"{own['mean_ratio']:.3f}", f"{own['worst_ratio']:.2f}", *told])


def pose_table(record: dict) -> str:
    """Clouds and how often a camera was found for them."""
    header = ["cloud", "median error, degrees", "within 15", "the same, or mirrored in depth", "one of the answers"]
    header += ["sure (of them right)", "focal lengths that fit as well, over the true one", "seconds"]
    rows = [header, ["---"] * len(header)]
    for name, own in record["summary"].items():
        counts = [f"{own[key]} of {own['cases']}" for key in ("right", "mirrored", "answers")]
        range_of = f"{own['shortest']:.2g} to {own['longest']:.2g}"
        sure = f"{own['sure']} ({own['sure_right']})"
        rows.append([name, f"{own['median_degrees']:.1f}", *counts, sure, range_of, f"{own['median_seconds']:.2f}"])
    return "\n".join("| " + " | ".join(row) + " |" for row in rows)
