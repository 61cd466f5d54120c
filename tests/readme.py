"""The commands and tables of the pages: run, compare, and write anew.

python -m tests.readme      runs every command of README.md and puts what it printed below it, and the tables of the
                            kept figures into README.md and docs/results.md; takes as long as `tso train`
"""

from __future__ import annotations

import json
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[1]
README = ROOT / "README.md"
RESULTS = ROOT / "docs" / "results.md"
NETWORK = ROOT / "docs" / "network.md"
PAGES = (README, RESULTS, NETWORK)
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
    rows = ["| list | category | shapes | " + " | ".join(names.values()) + " | network / mean, view | network / nearest |"]
    rows.append("|---" * (len(names) + 5) + "|")
    for part, summary in record["summary"].items():
        for category, own in summary.items():
            values = [f"{1e3 * own[name]:.2f}" for name in names]
            values += [f"{own['over_mean_view']:.2f}", f"{own['over_nearest']:.2f}"]
            rows.append(f"| {part} | {category} | {own['shapes']} | " + " | ".join(values) + " |")
    return "\n".join(rows)


def tables() -> dict[str, str]:
    """Name -> table, from the kept figures."""
    return {
        "network": network_table(json.loads((FIGURES / "network.json").read_text())),
        "examples": examples_table(json.loads((FIGURES / "examples.json").read_text())),
        "points": points_table(json.loads((FIGURES / "points.json").read_text())),
    }


def with_tables(text: str) -> str:
    """``text`` with what stands between ``<!-- NAME -->`` and ``<!-- end -->`` made anew."""
    for name, table in tables().items():
        text = re.sub(rf"(<!-- {name} -->\n).*?(\n<!-- end -->)", lambda m, t=table: m[1] + t + m[2], text, flags=re.DOTALL)
    return text


def _run(command: str, folder: Path) -> str:
    words = shlex.split(command)
    assert words[0] == "tso", command
    done = subprocess.run(
        [sys.executable, "-m", "tso_cli", *words[1:]], cwd=folder, stdout=subprocess.PIPE, text=True, check=True
    )
    return done.stdout.rstrip("\n")


def write_tables() -> None:
    """Put the tables of the kept figures into every page."""
    for page in PAGES:
        page.write_text(with_tables(page.read_text()))


def main() -> None:
    text = README.read_text()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        working_copy(folder)
        printed = iter([(command, _run(command, folder)) for command, _ in console_commands(text)])

        def fill(match: re.Match[str]) -> str:
            count = len(re.findall(r"^\$ ", match[1], flags=re.MULTILINE))
            blocks = [next(printed) for _ in range(count)]
            return "```console\n" + "".join(f"$ {command}\n{out}\n" for command, out in blocks) + "```"

        README.write_text(CONSOLE.sub(fill, text))
        shutil.copy(folder / "chair.png", ROOT / "docs" / "chair.png")
    write_tables()


if __name__ == "__main__":
    main()
