"""The tables of docs/accuracy.md, from the kept records of `tso lab accuracy`."""

from __future__ import annotations

SHOWN = ("paper", "best", "best, no symmetry", "best, two masks", "best, four masks")


def accuracy_tables(record: dict) -> dict[str, str]:
    """Table name -> Markdown, of one record."""
    if record["settings"]["ablation"]:
        return {"ablation": ablation_table(record)}
    found = {f"{kind}": kind_table(own) for kind, own in record["summary"].items()}
    if "other" in record["summary"]:
        found["ratios"] = ratios_table(record["summary"]["other"])
        found["bounds"] = bounds_table(record["summary"])
    found["settings"] = settings_line(record)
    return found


def settings_line(record: dict) -> str:
    """What the figures are of."""
    settings = record["settings"]
    shapes = f"{len(settings['shapes'])} {settings['part']} shapes ({', '.join(settings['categories'])})"
    masks = f"masks of {settings['size']}x{settings['size']}, {settings['points']:,} points"
    return f"{shapes}, {settings['views']} views each, {masks}, seed {settings['seed']}, {settings['device']}."


def ratios_table(summary: dict) -> str:
    """Mean Chamfer after / before and median seconds, a column a variant, and how the default's cases that get worse do."""
    names = [name for name in SHOWN if name in next(iter(summary.values()))["variants"]]
    rows = [["from", *names, "best: made worse, at worst"], ["---"] * (len(names) + 2)]
    for category, group in summary.items():
        cells = [
            f"{group['variants'][name]['mean_ratio']:.2f}, {group['variants'][name]['median_seconds']:.2f} s" for name in names
        ]
        default = group["variants"]["best"]
        harm = f"{default['worse']} of {group['cases']}, {default['worst_ratio']:.2f}"
        rows.append([f"{category}, {1e3 * group['before']['chamfer']:.1f}", *cells, harm])
    return _markdown(rows)


def kind_table(summary: dict) -> str:
    """Everything measured of the cases of one kind."""
    header = ["category, cases", "variant", "Chamfer x1000", "mean ratio", "median", "worst", "made worse", "by over 5 %"]
    header += ["excess over the floor", "16,384 target points", "F-score", "EMD x1000", "IoU", "seconds", "in a batch"]
    rows = [header, ["---"] * len(header)]
    for category, group in summary.items():
        before = group["before"]
        for name, own in group["variants"].items():
            rows.append(
                [
                    f"{category}, {group['cases']}",
                    name,
                    f"{1e3 * before['chamfer']:.2f} -> {1e3 * own['chamfer']:.2f}",
                    *(f"{own[key]:.3f}" for key in ("mean_ratio", "median_ratio", "worst_ratio")),
                    f"{100 * own['worse'] / group['cases']:.0f} %",
                    f"{100 * own['worse_by_5'] / group['cases']:.0f} %",
                    _number(own["chamfer_excess"]),
                    f"{own['dense_ratio']:.3f}",
                    f"{before['f_score']:.2f} -> {own['f_score']:.2f}",
                    "" if own["emd"] is None else f"{1e3 * before['emd']:.0f} -> {1e3 * own['emd']:.0f}",
                    f"{own['iou_before']:.2f} -> {own['iou']:.2f}",
                    _number(own["median_seconds"], 2),
                    _number(own["batch_seconds"], 2),
                ]
            )
    return _markdown(rows)


def bounds_table(summary: dict) -> str:
    """The level reached, and what bounds a refinement."""
    header = ["start", "category", "shapes", "Chamfer x1000 of the start", "floor / before", "all but depth right / before"]
    rows = [header, ["---"] * len(header)]
    # What is right starts at the floor.
    for kind in [kind for kind in summary if kind != "right"]:
        for category, group in summary[kind].items():
            before = group["before"]
            bounds = [_number(before.get(f"{bound}_ratio"), 2) for bound in ("floor", "in_plane")]
            rows.append([kind, category, str(group["shapes"]), f"{1e3 * before['chamfer']:.2f}", *bounds])
    return _markdown(rows)


def ablation_table(record: dict) -> str:
    """Mean ratio, share made worse and worst ratio; a row an ingredient, a column a kind and category."""
    columns = [(kind, category) for kind, own in record["summary"].items() for category in own]
    groups = [record["summary"][kind][category]["variants"] for kind, category in columns]
    rows = [["", *(f"{category}, {kind}" for kind, category in columns)], ["---"] * (len(columns) + 1)]
    cases = [record["summary"][kind][category]["cases"] for kind, category in columns]
    for name in groups[0]:
        cells = [
            f"{own[name]['mean_ratio']:.2f} ({100 * own[name]['worse'] / count:.0f} %, {own[name]['worst_ratio']:.2f})"
            for own, count in zip(groups, cases, strict=True)
        ]
        rows.append([name, *cells])
    found = [[case for case in record["cases"] if (case["kind"], case["category"]) == column] for column in columns]
    best = [sum(min(_ratio(case, name) for name in case["variants"]) for case in own) / len(own) for own in found]
    rows.append(["the best of all", *(f"{ratio:.2f}" for ratio in best)])
    starts = [1e3 * record["summary"][kind][category]["before"]["chamfer"] for kind, category in columns]
    rows.append(["Chamfer x1000 of the start", *(f"{start:.1f}" for start in starts)])
    return _markdown(rows)


def sizes_table(*records: dict) -> str:
    """Mean and worst ratio on ever more points and pixels, of the views that all records have; the last against the first."""
    labels = [f"{r['settings']['points']:,} points, {r['settings']['size']}x{r['settings']['size']}" for r in records]
    rows = [["category, cases", "variant", *labels, "gains at least as much"]]
    rows.append(["---"] * len(rows[0]))
    found = [{(case["shape"], case["view"]): case for case in record["cases"] if case["kind"] == "other"} for record in records]
    for category in records[-1]["summary"]["other"]:
        common = [key for key, case in found[-1].items() if case["category"] == category and all(key in own for own in found)]
        for name in SHOWN:
            ratios = [[_ratio(own[key], name) for key in common] for own in found]
            means = [round(sum(own) / len(own), 3) for own in ratios]
            cells = [f"{mean:.3f}, worst {max(own):.2f}" for mean, own in zip(means, ratios, strict=True)]
            rows.append([f"{category}, {len(common)}", name, *cells, "yes" if means[-1] <= means[0] else "**no**"])
    return _markdown(rows)


def _ratio(case: dict, name: str) -> float:
    return case["variants"][name]["chamfer"] / case["before"]["chamfer"]


def _number(value: float | None, decimals: int = 3) -> str:
    return "" if value is None else f"{value:.{decimals}f}"


def _markdown(rows: list[list[str]]) -> str:
    return "\n".join("| " + " | ".join(row) + " |" for row in rows)
