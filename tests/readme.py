"""The commands and tables of the pages: run, compare, and write anew.

python -m tests.readme            runs every command of README.md and puts what it printed below it, and the tables of the
                                  kept figures into README.md and docs; takes as long as `tso train`
python -m tests.readme --quick    leaves what `tso train` and what comes of it printed as it is; takes a minute
python -m tests.readme --tables   puts the tables into the pages and runs nothing
"""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from tests.readme_accuracy import accuracy_tables, sizes_table
from tests.readme_evidence import evidence_tables, pose_table
from tso_cli.lab.charts.speed_table import left_out_lines, machine_line, sections

ROOT = Path(__file__).parents[1]
README = ROOT / "README.md"
RESULTS = ROOT / "docs" / "results.md"
NETWORK = ROOT / "docs" / "network.md"
PERFORMANCE = ROOT / "docs" / "performance.md"
ACCURACY = ROOT / "docs" / "accuracy.md"
PHOTOS = ROOT / "docs" / "photos.md"
METHOD = ROOT / "docs" / "method.md"
PAGES = (README, METHOD, RESULTS, NETWORK, PERFORMANCE, ACCURACY, PHOTOS)
FIGURES = ROOT / "docs" / "figures"
CONSOLE = re.compile(r"```console\n(.*?)```", re.DOTALL)


def console_commands(text: str) -> list[tuple[str, str]]:
    """(command, what it prints) of every console block, in order."""
    found = []
    for block in CONSOLE.findall(text):
        for part in re.split(r"^\$ ", block, flags=re.MULTILINE)[1:]:
            command, _, printed = part.partition("\n")
            found.append((command, printed.rstrip("\n")))
    return found


def working_copy(folder: Path) -> None:
    """What the commands of the README find where they are run."""
    shutil.copytree(ROOT / "examples", folder / "examples")


def examples_table(record: dict) -> str:
    """The shipped examples as Markdown."""
    rows = ["| example | mode | IoU | Chamfer x1000 | after / before | seconds |", "|---|---|---|---|---|---|"]
    rows += [
        f"| {r['example']} | {r['mode']} | {r['iou_before']:.3f} -> {r['iou_after']:.3f} | "
        f"{1e3 * r['chamfer_before']:.2f} -> {1e3 * r['chamfer_after']:.2f} | {r['ratio']:.3f} | {r['seconds']:.2f} |"
        for r in record["examples"]
    ]
    return "\n".join(rows)


def points_table(record: dict) -> str:
    """The study of points mode as Markdown."""
    rows = [
        "| category | shapes | Chamfer x1000 | after / before | worst shape | made worse | IoU | seconds |",
        "|---|---|---|---|---|---|---|---|",
    ]
    rows += [
        f"| {name} | {s['cases']} | {1e3 * s['chamfer_before']:.2f} -> {1e3 * s['chamfer_after']:.2f} | "
        f"{s['ratio_of_means']:.3f} | {s['worst_ratio']:.3f} | {s['worse']} | {s['iou_before']:.2f} -> {s['iou_after']:.2f} | "
        f"{s['median_seconds']:.2f} |"
        for name, s in record["summary"].items()
    ]
    return "\n".join(rows)


def network_table(record: dict) -> str:
    """The base network and its rivals as Markdown."""
    names = {"network": "network", "mean_view": "mean, view", "mean_aligned": "mean, aligned", "nearest": "nearest"}
    ratios = {"over_mean_view": "mean, view", "over_mean_aligned": "mean, aligned", "over_nearest": "nearest"}
    rows = [
        "| list | category | shapes | "
        + " | ".join([*names.values(), *(f"network / {label}" for label in ratios.values())])
        + " |"
    ]
    rows.append("|---" * (len(names) + 6) + "|")
    for part, summary in record["summary"].items():
        for category, own in summary.items():
            values = [f"{1e3 * own[name]:.2f}" for name in names]
            values += [f"{own[name]:.2f}" for name in ratios]
            rows.append(f"| {part} | {category} | {own['shapes']} | " + " | ".join(values) + " |")
    return "\n".join(rows)


def variants_table(record: dict) -> str:
    """The paper's table of test-stage optimisation, ours and theirs, as Markdown."""
    names = {"before": "before", "encoder": "E", "encoder-decoder": "E and D", "points": "p"}
    rows = [
        "| shapes | variant | forward | backward | sum | after / before | 95 % interval | unscaled | made worse | visible | "
        "occluded | IoU | seconds |"
    ]
    rows.append("|---" * 13 + "|")
    for category, summary in record["summary"].items():
        for name, label in names.items():
            own = summary["capnet"][name]
            cells = [f"{category}, {summary['shapes']}", label]
            cells += [f"{1e3 * own[key]:.2f}" for key in ("forward", "backward", "chamfer")]
            if name == "before":
                cells += [""] * 4
            else:
                cells += [f"{own['ratio_of_means']:.3f}", " to ".join(f"{end:.3f}" for end in own["interval"])]
                cells += [f"{summary['plain'][name]['ratio_of_means']:.3f}", f"{own['worse']} of {summary['cases']}"]
            cells += [f"{1e3 * own[key]:.2f}" for key in ("visible", "occluded")]
            cells += [f"{summary['iou'][name]:.3f}", f"{summary['median_seconds'][name]:.2f}" if name != "before" else ""]
            rows.append("| " + " | ".join(cells) + " |")
    for name, label in names.items():
        forward, backward, total = record["paper"][name]
        ratio = "" if name == "before" else f"{total / record['paper']['before'][2]:.3f}"
        rows.append(f"| *the paper* | {label} | {forward:.2f} | {backward:.2f} | {total:.2f} | {ratio} | | | | | | | |")
    return "\n".join(rows)


def settings_table(record: dict) -> str:
    """What networks trained with different settings reached, and in the paper, as Markdown."""
    return _table({**record["summary"], **{f"*{name}, the paper*": own for name, own in record["paper"].items()}})


def views_table(record: dict) -> str:
    """Chamfer over the number of masks, with each seed's where there are several, the constant answer, and the paper's."""
    rows = {}
    for category, values in record["summary"].items():
        rows[category] = {**values, "mean training shape": record["constant"][category]}
        seeds = record["seeds"][category]
        rows[f"{category}, by seed"] = {
            count: ", ".join(f"{value:.2f}" for value in own) for count, own in seeds.items() if len(own) > 1
        }
        if category in record["paper"]:
            rows[f"*{category}, the paper*"] = record["paper"][category]
    return _table(rows)


def affinity_table(record: dict) -> str:
    """Outliers in per cent and Chamfer with and without the affinity loss, as Markdown."""
    return _table(
        {
            setting: {
                f"{category}: {label}": factor * values[key]
                for category, values in own.items()
                for key, label, factor in (("outliers", "outliers, %", 100.0), ("chamfer", "Chamfer", 1.0))
            }
            for setting, own in record["summary"].items()
        }
    )


def failures_table(record: dict) -> str:
    """Sizes of aeroplanes, then errors of cars, as Markdown."""
    planes = {name: own for name, own in record["summary"].items() if "span" in own}
    cars = {
        name: {
            "error in depth x1000": 1e3 * own["depth"],
            "across x1000": 1e3 * own["across"],
            "extent in depth": own["extent"],
            "Chamfer": own["chamfer"],
        }
        for name, own in record["summary"].items()
        if "depth" in own
    }
    sizes = {
        name: {key.replace("_", " ").replace("chamfer", "Chamfer"): v for key, v in own.items()} for name, own in planes.items()
    }
    return f"{_table(sizes)}\n\n{_table(cars)}"


def _table(found: dict[str, dict]) -> str:
    """A row for each name; columns in the order of the first row."""
    columns = list(dict.fromkeys(key for own in found.values() for key in own))
    rows = ["| | " + " | ".join(columns) + " |", "|---" * (len(columns) + 1) + "|"]
    for name, own in found.items():
        values = [own.get(key) for key in columns]
        cells = ["" if value is None else value if isinstance(value, str) else f"{value:.2f}" for value in values]
        rows.append(f"| {name} | " + " | ".join(cells) + " |")
    return "\n".join(rows)


def departures_table(record: dict) -> str:
    """What `tso train` does otherwise than the paper, and Chamfer with each thing done the other way, as Markdown."""
    base = record["base"]
    columns = [name for name in record["summary"][base] if name != "mean"]
    rows = [
        "| changed | the paper, or its authors' code | here | " + " | ".join(columns) + " |",
        "|---" * (len(columns) + 3) + "|",
    ]
    for name, own in record["summary"].items():
        cells = [f"{own[column]:.2f}" for column in columns]
        if name == base:
            seeds = record["seeds"]
            cells = [f"{cell} ({min(seeds[c]):.2f} to {max(seeds[c]):.2f})" for cell, c in zip(cells, columns, strict=True)]
        rows.append(
            "| "
            + " | ".join([f"*{name}*" if name not in record["why"] else name, *record["why"].get(name, ("", "")), *cells])
            + " |"
        )
    return "\n".join(rows)


def sigma_table(record: dict) -> str:
    """The best sigma^2 of each category as Markdown."""
    rows = ["| category | shapes | best sigma^2 | error | the paper's | error there |", "|---|---|---|---|---|---|"]
    rows += [
        f"| {name} | {s['shapes']} | {s['best']:g} | {s['l1_at_best']:.4f} | {s['paper']:g} | {s['l1_at_paper']:.4f} |"
        for name, s in record["summary"].items()
    ]
    return "\n".join(rows)


def photos_table(record: dict) -> str:
    """Starts, presets and numbers of photos, judged by the other photos; auto found no symmetry and is left out."""
    rows = ["| start carved by | photos | preset | IoU, mean | worst | points beside a mask, mean | worst |", "|---" * 7 + "|"]
    for own in record["summary"]:
        if own["symmetry"] == "auto":
            continue
        cells = [f"{len(own['start'])} photo" + "s" * (len(own["start"]) > 1)]
        cells += [str(len(own["masks"])) if own["masks"] else "", own["preset"] or "*start*"]
        cells += [f"{own['iou']:.3f}", f"{own['worst_iou']:.3f}", f"{own['beside']:.1%}", f"{own['most_beside']:.1%}"]
        rows.append("| " + " | ".join(cells) + " |")
    return "\n".join(rows)


def speed_tables(record: dict) -> dict[str, str]:
    """What is measured of the speed -> its table as Markdown; what was left out, and the machine."""
    made = {
        section.name: "\n".join(
            "| " + " | ".join("" if cell is None else str(cell) for cell in row) + " |"
            for row in (section.header, ["---"] * len(section.header), *section.rows)
        )
        for section in sections(record)
    }
    left_out = "\n".join(f"- {line}" for line in left_out_lines(record["records"]))
    return made | {"left out": left_out, "machine": machine_line(record)}


def claims_list(record: dict) -> str:
    """What the paper says, or what is asked, and whether it holds here."""
    return "\n".join(
        f"- {'Holds' if claim['holds'] else '**Does not hold**'}: {claim['claim']} ({claim['found']})."
        for claim in record["claims"]
    )


SIZES = ("accuracy", "accuracy-128", "accuracy-256", "accuracy-large")
TABLES = {
    "examples": examples_table,
    "points": points_table,
    "network": network_table,
    "tso": variants_table,
    "sigma": sigma_table,
    "supervision": settings_table,
    "views": views_table,
    "lambda": settings_table,
    "affinity": affinity_table,
    "failures": failures_table,
    "departures": departures_table,
    "photos": photos_table,
    "pose": pose_table,
}


def tables() -> dict[str, str]:
    """Name -> table, from the kept figures."""
    made = {}
    accuracy = {}
    for path in sorted(FIGURES.glob("*.json")):
        record = json.loads(path.read_text())
        if record.get("study") == "accuracy":
            accuracy[path.stem] = record
            made |= {f"{path.stem} {name}": table for name, table in accuracy_tables(record).items()}
        elif record.get("study") == "evidence":
            made |= {f"{path.stem} {name}": table for name, table in evidence_tables(record).items()}
        elif {"summary", "examples"} & set(record):
            made[path.stem] = TABLES[path.stem](record)
        if "bench" in record:
            made |= {f"{path.stem} {name}": table for name, table in speed_tables(record).items()}
        if "claims" in record:
            made[f"{path.stem} claims"] = claims_list(record)
    if set(SIZES) <= set(accuracy):
        made["accuracy sizes"] = sizes_table(*(accuracy[name] for name in SIZES))
    return made


def shown_records() -> list[str]:
    """Names of the kept records that a table or a chart of some page is of."""
    text = "".join(page.read_text() for page in [README, *ROOT.glob("docs/*.md")])
    shown = set(re.findall(r"<!-- ([\w-]+)", text)) | set(re.findall(r"\]\((?:docs/)?figures/([\w-]+)\.", text))
    return sorted(path.stem for path in FIGURES.glob("*.json") if path.stem in shown)


def command_that_remakes(name: str) -> str:
    """The command of the pages that writes the record ``name``."""
    text = "\n".join(page.read_text() for page in ROOT.glob("docs/*.md"))
    (found,) = set(re.findall(rf"(?:tso|python) [^`\n]*-o (?:docs/figures/)?{name}\.json[^`\n)]*", text))
    return found.strip()


def with_tables(text: str) -> str:
    """``text`` with what stands between ``<!-- NAME -->`` and ``<!-- end -->`` made anew."""
    for name, table in tables().items():
        text = re.sub(rf"(<!-- {name} -->\n).*?(<!-- end -->)", lambda m, t=table: f"{m[1]}{t}\n{m[2]}", text, flags=re.DOTALL)
    return text


def _run(command: str, folder: Path) -> str:
    words = shlex.split(command)
    assert words[0] == "tso", command
    own = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, "-m", "tso_cli", *words[1:]], cwd=folder, env=own, stdout=subprocess.PIPE, text=True, check=True
    )
    return done.stdout.rstrip("\n")


def write_tables() -> None:
    """Put the tables of the kept figures into every page."""
    for page in PAGES:
        page.write_text(with_tables(page.read_text()))


def _quick(command: str) -> bool:
    """Whether it neither trains nor uses what was trained."""
    return "tso train" not in command and "base.safetensors" not in command


def main(quick: bool) -> None:
    text = README.read_text()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        working_copy(folder)
        printed = iter(
            [
                (command, shown if quick and not _quick(command) else _run(command, folder))
                for command, shown in console_commands(text)
            ]
        )

        def fill(match: re.Match[str]) -> str:
            count = len(re.findall(r"^\$ ", match[1], flags=re.MULTILINE))
            blocks = [next(printed) for _ in range(count)]
            return "```console\n" + "".join(f"$ {command}\n{out}\n" for command, out in blocks) + "```"

        README.write_text(CONSOLE.sub(fill, text))
        shutil.copy(folder / "chair.png", ROOT / "docs" / "chair.png")
    write_tables()


if __name__ == "__main__":
    write_tables() if "--tables" in sys.argv else main("--quick" in sys.argv)
