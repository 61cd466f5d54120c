"""The commands and figures of README and docs: run, compared, and written anew.

python -m tests.readme             runs the commands of the pages and fills in output and figures
python -m tests.readme --figures   fills in the figures alone
"""

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Sequence
from functools import cache, partial
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
README = ROOT / "README.md"
PAGES = (README, ROOT / "CONTRIBUTING.md", *sorted(DOCS.glob("*.md")))
RECORDS = DOCS / "records"
KINDS = {
    "other": "another shape of the same type",
    "turned": "another shape; the whole scene is turned",
    "near": "another shape close to the truth",
    "cut": "another shape; the object is truncated",
    "network": "the shipped network's prediction",
    "unseen": "the warped truth, of a kind in no list",
    "right": "the truth itself, sampled anew",
}
CONSOLE = re.compile(r"```console\n(.*?)```", re.DOTALL)


def console_commands(text: str) -> list[tuple[str, str]]:
    """(command, what it prints) of every console block, in order."""
    blocks = [re.split(r"^\$ ", block, flags=re.MULTILINE)[1:] for block in CONSOLE.findall(text)]
    parts = [part.partition("\n") for block in blocks for part in block]
    return [(command, printed.rstrip("\n")) for command, _, printed in parts]


def python_blocks(page: Path) -> list[str]:
    """The Python code that a page shows, in order."""
    return re.findall(r"```python\n(.*?)```", page.read_text(), flags=re.DOTALL)


def working_copy(folder: Path) -> None:
    """Put into ``folder`` the files that the commands of the pages use."""
    shutil.copytree(ROOT / "examples", folder / "examples")


@cache
def record(name: str) -> dict[str, Any]:
    """The kept record of a study."""
    content: dict[str, Any] = json.loads((RECORDS / f"{name}.json").read_text())
    return content


def markdown(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table."""
    lines = ["| " + " | ".join(row) + " |" for row in (header, *rows)]
    return "\n".join([lines[0], "|---" * len(header) + "|", *lines[1:]])


def initial_error() -> str:
    """The error of the shipped chair's initial cloud."""
    from tso_cli.evaluation.metrics import chamfer
    from tso_cli.io.clouds import read_cloud

    initial, target = (
        read_cloud(ROOT / "examples" / "chair" / f"{name}.ply").points
        for name in ("initial", "target")
    )
    before = 1e3 * chamfer(initial, target).chamfer
    return f"The Chamfer distance of the initial cloud was {before:.3f}."


def misplaced_error() -> str:
    """The error of the cloud in the wrong place, before and after."""
    from tso_cli import refine
    from tso_cli.evaluation.metrics import chamfer
    from tso_cli.io.cameras import read_camera
    from tso_cli.io.clouds import read_cloud
    from tso_cli.io.masks import read_mask

    chair = ROOT / "examples" / "chair"
    given, target = (read_cloud(chair / f"{name}.ply").points for name in ("misplaced", "target"))
    mask = read_mask(chair / "mask.png")
    moved = refine(given, mask, read_camera(chair / "camera.json", *mask.shape[::-1])).points
    before, after = (1e3 * chamfer(points, target).chamfer for points in (given, moved))
    return (
        f"The Chamfer distance falls from {before:.2f} to {after:.2f}. What is left is mostly the "
        "distance,\nwhich one mask hardly shows."
    )


def advice() -> str:
    """What each choice brings and costs, by what a user has."""
    rows = [
        ("a cloud, one mask", "the default", "other", "points, best"),
        ("", "`--points 512`", "other", "points, best, 512 move"),
        ("", "`--prior none`", "other", "points, best, no learned prior"),
        ("", "`--preset paper`", "other", "points, paper"),
        (
            "",
            "(PyTorch3D's soft renderer of points, for comparison; not part of tso)",
            "other",
            "alpha points",
        ),
        ("a cloud, two masks", "the default", "other", "points, best, 2 masks"),
        ("a cloud, four masks", "the default", "other", "points, best, 4 masks"),
        ("a photo and its mask", "`--mode latent`", "network", "latent, best"),
        (
            "",
            "`--mode encoder-decoder`, then points mode",
            "network",
            "encoder-decoder, then points",
        ),
    ]
    cells = (
        "{mean_ratio:.2f} ± {standard_error:.2f}|{median_seconds:.2f}"
        "|{worse} of {cases}, {worst_ratio:.2f}"
    )
    study = record("pareto")["summary"]
    figures = [
        cells.format_map(study[kind] | study[kind]["ways"][way]).split("|")
        for _, _, kind, way in rows
    ]
    header = ["you have", "use", "after / before", "seconds", "made worse, worst"]
    return markdown(header, [[*row[:2], *found] for row, found in zip(rows, figures, strict=True)])


def paper() -> str:
    """What the three variants of the paper gain here, and there."""
    variants = {"encoder": "encoder", "encoder-decoder": "encoder and decoder", "points": "points"}
    study = record("tso")
    before = study["paper"]["before"][2]
    here, there = [], []
    for name, words in variants.items():
        ratio = study["summary"]["all"]["capnet"][name]["ratio_of_means"]
        here.append(f"{100 * (1 - ratio):.1f} % ({words})")
        there.append(f"{100 * (1 - study['paper'][name][2] / before):.1f} %")
    return (
        "With `--preset paper`, tso lowers the Chamfer distance of network predictions by\n"
        f"{here[0]}, {here[1]} and {here[2]}.\n"
        f"The paper reports {there[0]}, {there[1]} and {there[2]}."
    )


def types() -> str:
    """By object type, the measures of the default preset with one mask."""
    summary = record("accuracy")["summary"]
    rows = []
    for name, group in {**summary["other"], **summary.get("unseen", {})}.items():
        before, row = group["before"], group["variants"]["best"]
        chamfer = f"{1e3 * before['chamfer']:.1f} -> {1e3 * row['chamfer']:.1f}"
        ratios = (
            f"{row['mean_ratio']:.2f}",
            f"{row['worst_ratio']:.2f}",
            str(row["worse"]),
            f"{group['bound_ratio']:.2f}" if "bound_ratio" in group else "-",
            f"{before['floor_ratio']:.2f}",
        )
        measures = (
            f"{before['f_score']:.2f} -> {row['f_score']:.2f}",
            f"{row['iou_before']:.2f} -> {row['iou']:.2f}",
        )
        rows.append([f"{name}, {group['cases']}", chamfer, *ratios, *measures])
    header = [
        "object, clouds",
        "Chamfer x1000",
        "mean",
        "worst",
        "made worse",
        "oracle",
        "floor",
        "F-score",
        "IoU",
    ]
    return markdown(header, rows)


def prior() -> str:
    """What the learned prior brings: with one mask, by type for other shapes, then by start."""
    kinds = record("accuracy-ablation")["summary"]
    names = ("best", "no learned prior")
    rows = []
    for category, group in kinds["other"].items():
        cells = (group["variants"][name] for name in names)
        ratios = [f"{row['mean_ratio']:.2f}, {row['worst_ratio']:.2f}" for row in cells]
        rows.append([KINDS["other"], f"{category}, {group['cases']}", *ratios])
    for kind in list(kinds)[1:]:
        cells = (pooled(kind, name, "accuracy-ablation") for name in names)
        total = sum(group["cases"] for group in kinds[kind].values())
        rows.append(
            [KINDS[kind], f"all, {total}", *(f"{mean}, {worst}" for mean, worst, _ in cells)]
        )
    return markdown(["start", "object, clouds", "with the learned prior", "without"], rows)


def aims() -> str:
    """Aims of the default, what it comes to, and what an oracle does; ratios of means."""
    from tso_lab.studies.accuracy import AIMS, ALL

    rows = []
    for kind, of_kind in AIMS.items():
        groups = record("accuracy")["summary"][kind]
        for category, of_category in of_kind.items():
            chosen = list(groups.values()) if category == ALL else [groups[category]]
            before = sum(group["cases"] * group["before"]["chamfer"] for group in chosen)
            for variant, aim in of_category.items():
                after = sum(g["cases"] * g["variants"][variant]["chamfer"] for g in chosen)
                masks = {"best": "one", "best, two masks": "two"}[variant]
                bound = groups.get(category, {}).get("bound_ratio")
                cells = (f"{aim:.2f}", f"{after / before:.2f}")
                of_one = f"{bound:.2f}" if bound and masks == "one" else "-"
                rows.append([KINDS[kind], f"{category}, {masks}", *cells, of_one])
    return markdown(["start", "object, masks", "aim", "result", "oracle"], rows)


def pooled(kind: str, variant: str, study: str = "accuracy") -> list[str]:
    """Of all object types: mean and worst Chamfer after / before, and how many got worse."""
    groups = [
        (group["cases"], group["variants"][variant])
        for group in record(study)["summary"][kind].values()
    ]
    total = sum(cases for cases, _ in groups)
    mean = sum(cases * row["mean_ratio"] for cases, row in groups) / total
    worst, worse = (
        max(row["worst_ratio"] for _, row in groups),
        sum(row["worse"] for _, row in groups),
    )
    return [f"{mean:.2f}", f"{worst:.2f}", f"{worse} of {total}"]


def starts() -> str:
    """By kind of start: mean, worst, and how many got worse."""
    variants = {"paper": "paper", "default": "best", "default, four masks": "best, four masks"}
    rows = [
        [label, *(", ".join(pooled(kind, name)) for name in variants.values())]
        for kind, label in KINDS.items()
        if kind in record("accuracy")["summary"]
    ]
    return markdown(["start", *variants], rows)


def depth() -> str:
    """What a depth map and a second mask bring, without and with a mirror plane."""
    rows = {
        "one mask": "mask, no symmetry",
        "one mask, mirror plane": "mask, symmetry auto",
        "two masks": "two masks, no symmetry",
        "one mask and its depth map": "mask and depth, no symmetry",
        "one mask and its depth map, mirror plane": "mask and depth, symmetry auto",
        "two masks and their depth maps": "two masks and their depths, no symmetry",
    }
    study = record("evidence")["summary"]["depth"]["other"]["all"]
    cells = [
        [label, f"{study[name]['mean_ratio']:.2f}", f"{study[name]['worst_ratio']:.2f}"]
        for label, name in rows.items()
    ]
    return markdown(["observations", "after / before", "worst"], cells)


def aims_met(name: str) -> str:
    """How many aims of a study are met."""
    claims = record(name)["claims"]
    met = sum(claim["holds"] for claim in claims)
    return f"{met} of {len(claims)} aims are met ([which](records/{name}.md))."


def cameras() -> str:
    """How often a camera is found from mask and cloud."""
    rows = [
        [
            name,
            f"{row['median_degrees']:.1f}",
            f"{row['exact']} of {row['cases']}",
            f"{row['right']} of {row['cases']}",
            str(row["sure"]),
            str(row["sure_right"]),
        ]
        for name, row in record("pose")["summary"].items()
    ]
    header = [
        "cloud",
        "median error, degrees",
        "within 3 degrees",
        "within 15 degrees",
        "called sure",
        "right among these",
    ]
    return markdown(header, rows)


def _per_cent(share: float | None) -> str:
    return "-" if share is None else f"{100 * share:.0f} %"


def confidence() -> str:
    """How well a low confidence marks results that are worse, by what is wrong with the input."""
    names = {
        "right scenes": "nothing",
        "in trouble": "something, or the start is exact",
        "mask": "masks",
        "camera": "the camera",
        "depth": "depth maps",
        "cloud": "the cloud",
    }
    summary = record("confidence")["summary"]
    rows = [
        [
            text,
            *(_per_cent(summary[name][key]) for key in ("worse", "flagged_of_worse", "silent")),
            # Fewer results that got worse say nothing of the area.
            f"{summary[name]['auc']:.2f}"
            if summary[name]["worse"] * summary[name]["results"] > 4.5
            else "-",
        ]
        for name, text in names.items()
    ]
    right, mixture = summary["right scenes"], record("confidence")["mixture"]
    note = (
        f"Of {right['results']} right scenes, {100 * right['flagged']:.0f} % were called doubtful, "
        f"and {100 * right['withheld']:.0f} % were left as\nthey were.\n\n"
        "The study always moved the points. Of 100 right scenes and 100 others, "
        f"{200 * mixture['worse']:.0f}\nresults got worse by over 5 %, and "
        f"{200 * mixture['unflagged']:.0f} without a word. The mean logarithm of\n"
        f"after / before was {mixture['always']:.2f}. It is {mixture['left']:.2f} if the clouds "
        "that tso leaves count as unchanged."
    )
    header = ["what is wrong", "worse by over 5 %", "flagged, of those worse", "silent", "AUC"]
    return f"{markdown(header, rows)}\n\n{note}"


def harm() -> str:
    """What becomes of clouds in the troubles of the field, beside the paper's preset."""
    summary = record("harm")["summary"]
    names = {"default": "default", "shape": "`--move shape`", "paper": "`--preset paper`"}
    starts = {"exact": "the right cloud", "other": "a cloud of another shape"}
    ends = ("silent", "said", "gained", "withheld")
    rows = [
        [text, start, str(row["runs"]), *(f"{row[end]:.0f} %" for end in ends)]
        for name, text in names.items()
        for key, start in starts.items()
        for row in [summary[name]["all"][key]]
    ]
    header = ["setting", "start", "runs", "worse, not said", "worse, said", "better", "gain left"]
    return markdown(header, rows)


def determined() -> str:
    """How much of a shape masks and depth maps fix, and how wrong the result is."""
    summary = record("determined")["summary"]
    rows = [
        [name, f"{row['determined']:.2f}", f"{row['ratio']:.2f}"] for name, row in summary.items()
    ]
    few, many = (summary[name]["error"] for name in ("1 mask", "8 masks"))
    note = (
        "The point confidence ranks points weakly: its rank correlation with the distance to the "
        f"true surface is {few:.2f}\nwith one mask, and {many:.2f} with eight."
    )
    return f"{markdown(['evidence', '`determined`', 'error'], rows)}\n\n{note}"


def network() -> str:
    """The shipped network on types that it has not seen."""
    keys = ("network", "mean_view", "mean_aligned", "nearest")
    summary = record("network")["summary"]["test"].items()
    rows = [
        [f"{name}, {row['shapes']}", *(f"{1e3 * row[key]:.2f}" for key in keys)]
        for name, row in summary
    ]
    return markdown(
        ["object, shapes", "network", "mean shape, view", "mean shape, aligned", "nearest shape"],
        rows,
    )


def photos() -> str:
    """The temple before and after, compared with photos that were not used."""
    shown = (
        row
        for row in record("photos")["summary"]
        if row["symmetry"] != "auto" and len(row["masks"]) in (0, 4)
    )
    cells = "{start} {preset} {iou:.2f} {worst_iou:.2f} {beside:.0%}"
    rows = [
        cells.format_map(
            row | {"start": len(row["start"]), "preset": row["preset"] or "none"}
        ).split()
        for row in shown
    ]
    return markdown(
        ["start carved from photos", "preset", "IoU, mean", "IoU, worst", "points outside a mask"],
        rows,
    )


def moves() -> str:
    """Errors of clouds of the right shape in a wrong place, and of a wrong shape, by `--move`."""
    rows: dict[str, list[list[str]]] = {"right": [], "near": [], "other": []}
    for start, ways in record("moves")["summary"].items():
        kind, off = start.split(", ")
        off = off.removesuffix(" off").replace("0 degrees", "nothing")
        if kind == "right":
            cells = [f"{row['after']:.2f} ({100 * row['bent']:.1f} %)" for row in ways.values()]
            some = next(iter(ways.values()))
            rows[kind].append([off, f"{some['before']:.2f}", *cells, f"{some['floor']:.2f}"])
        else:
            shape = {"near": "a similar one", "other": "another"}[kind]
            rows[kind].append([shape, off, *(f"{row['mean_ratio']:.2f}" for row in ways.values())])
    names = [f"`{way}`" for way in ways]
    right = markdown(["off by", "as given", *names, "floor"], rows["right"])
    wrong = markdown(["shape", "off by", *names], rows["near"] + rows["other"])
    return (
        "Clouds of the right shape, errors (and how far the points move within it):\n\n"
        f"{right}\n\nClouds of a wrong shape, error after / before:\n\n{wrong}"
    )


def seconds_of_moves() -> str:
    """What looking for a move costs."""
    study = record("moves")["summary"]
    wrong, right = (study[f"{start} degrees off"] for start in ("other, 0", "right, 6"))
    seconds = [
        f"{ways[way]['median_seconds']:.2f}"
        for ways, way in ((wrong, "shape"), (wrong, "auto"), (right, "auto"), (right, "pose"))
    ]
    return (
        f"The median run takes {seconds[0]} s with `shape`. With `auto` it takes {seconds[1]} s "
        f"where nothing moves, and\n{seconds[2]} s where the cloud moves. With `pose` it takes "
        f"{seconds[3]} s."
    )


def brought_back() -> str:
    """How many clouds of the right shape `--move pose` brings back, by size of the mask."""
    study = record("moves")["by_size"]
    sizes = list(next(iter(study.values())))
    rows = [
        [
            start.removeprefix("right, ").removesuffix(" off"),
            *(f"{row['near_floor']:.0%} ({100 * row['bent']:.2f} %)" for row in of_sizes.values()),
        ]
        for start, of_sizes in study.items()
        if not start.startswith("right, 0 ")
    ]
    return markdown(["off by", *(f"{size} mask" for size in sizes)], rows)


def machine() -> str:
    """Where the times were taken."""
    settings = record("speed")["settings"]
    cpu, versions = settings["machine"], settings["versions"]
    return (
        f"{cpu['cpu']}, {cpu['cores']} cores, torch {versions['torch']}, numpy {versions['numpy']}."
    )


def installation() -> str:
    """How much is installed."""
    megabytes = record("speed")["settings"]["installed_MB"]
    return (
        f"`pip install .` takes {megabytes['without extras']:,} MB. "
        f"`pip install '.[network]'` takes {megabytes['with the extra network']:,} MB, "
        "with a torch for CPUs."
    )


def _timed(what: str) -> list[dict[str, Any]]:
    return [row for row in record("speed")["cases"] if row["what"] == what and row.get("seconds")]


def objects() -> str:
    """Milliseconds of one cloud on one thread of an idle machine, and beside `import torch`."""
    rows = [
        [
            row["preset"],
            f"{row['points']:,}",
            str(row["views"]),
            f"{1e3 * row['seconds']['median']:.0f}",
            f"{row['over_import_torch']:.2f}x",
        ]
        for row in _timed("object")
        if "preset" in row and row["threads"] == 1 and not row["busy"]
    ]
    return markdown(["preset", "points", "masks", "ms", "/ `import torch`"], rows)


def scale() -> str:
    """What many items cost, from the measured pace of the long batch."""
    study = record("scale")
    pace = {row["way"]: row["items_per_second"] for row in study["cases"] if "way" in row}
    cores = study["settings"]["machine"]["cores"]
    each, parent = cores / pace["tso batch"], pace["items that take no time"]
    rows = []
    for items in (1_000, 100_000, 10_000_000):
        row = [
            f"{items:,}",
            *(_duration(items * max(each / n, 1.0 / parent)) for n in (cores, 64, 1024)),
        ]
        rows.append([*row, _bytes(items * 21_000), _bytes(items * 700)])
    header = ["items", f"{cores} cores", "64 cores", "1,024 cores", "results, records", "journal"]
    text = (
        f"`tso batch` does {pace['tso batch']:.1f} items a second on {cores} cores, that is "
        f"{pace['tso batch'] / pace['shell loop']:.1f} times a shell loop\nover `tso refine` and "
        f"{pace['tso batch'] / pace['refine_batch']:.2f} times `refine_batch` "
        "([record](records/scale.md)). At this pace:"
    )
    feeds = round(parent * each, -1)
    (reading,) = (row for row in study["cases"] if "rows" in row)
    more = 10_000_000 / reading["rows"]
    limit = (
        "The parent process reads the manifest and keeps the journal. It is one process, so it is "
        "what\nends the growth: it hands out at most "
        f"{round(parent, -2):,.0f} items a second, as many as {feeds:,.0f} cores do.\n"
        f"Before the first item, it reads and checks the manifest: {reading['rows']:,} rows take "
        f"{reading['seconds']:.1f} s\nand {reading['MiB']:.0f} MiB, so 10,000,000 rows take "
        f"{more * reading['seconds'] / 60:.0f} minutes and {more * reading['MiB'] / 1024:.0f} GiB. "
        "With `--shard`, a machine keeps only\nits part of the rows."
    )
    return f"{text}\n\n{markdown(header, rows)}\n\n{limit}"


def _duration(seconds: float) -> str:
    if seconds < 120:
        return f"{max(1.0, seconds):.0f} s"
    if seconds < 7200:
        return f"{seconds / 60:.0f} min"
    return f"{seconds / 3600:.0f} h" if seconds < 172_800 else f"{seconds / 86400:.0f} days"


def _bytes(count: float) -> str:
    return f"{count / 1e9:.1f} GB" if count >= 1e9 else f"{count / 1e6:.0f} MB"


def batches() -> str:
    """Milliseconds a cloud in batches."""
    timed = [
        row
        for row in _timed("batch")
        if row.get("batch", 1) > 1 and (row["points"], row.get("views", 1)) == (1024, 1)
    ]
    cores = max(row["processes"] for row in timed)
    columns = [(1, False), (cores, False), (1, True), (cores, True)]
    rows = []
    for preset, size in dict.fromkeys((row["preset"], row["batch"]) for row in timed):
        of_batch = {
            (row["processes"], row["busy"]): row
            for row in timed
            if (row["preset"], row["batch"]) == (preset, size)
        }
        cells = [
            f"{1e3 * of_batch[key]['seconds']['median']:.0f}" if key in of_batch else ""
            for key in columns
        ]
        rows.append([preset, str(size), *cells])
    names = [
        f"{count} {'process' if count == 1 else 'processes'}{', busy' if busy else ''}"
        for count, busy in columns
    ]
    return markdown(["preset", "clouds", *names], rows)


def kernels() -> str:
    """Milliseconds of the two kernels and of other ways of doing the same."""
    points = (1024, 16384)
    ways = {
        "silhouette": ("tso", "scatter 9x9, torch"),
        "chamfer": ("tso", "two k-d trees a step, all workers"),
    }
    rows = []
    for what, names in ways.items():
        taken = {
            (row["name"], row["points"]): f"{1e3 * row['seconds']['median']:.3g}"
            for row in _timed(what)
        }
        rows += [
            [what, name, *(taken.get((name, count), "") for count in points)] for name in names
        ]
    return markdown(["kernel", "way", *(f"{count:,} points" for count in points)], rows)


def record_minutes() -> str:
    """The records that take longest, where they say how long they took."""
    taken = {
        path.stem: seconds / 60.0
        for path in RECORDS.glob("*.json")
        if (seconds := record(path.stem).get("seconds")) and seconds >= 240.0
    }
    rows = [
        [name, f"{minutes:.0f}"]
        for name, minutes in sorted(taken.items(), key=lambda item: -item[1])
    ]
    return markdown(["record", "minutes"], rows)


def plugin() -> str:
    """The example of a reader, which a test runs."""
    text = (ROOT / "tests/io/plugin_example.py").read_text()
    return f"```python\n{text.split(chr(10) * 2, 1)[1].strip()}\n```"


def cloud_plugin() -> str:
    """The example of a reader of clouds, which a test runs."""
    text = (ROOT / "tests/io/cloud_plugin_example.py").read_text()
    return f"```python\n{text.split(chr(10) * 2, 1)[1].strip()}\n```"


FIGURES = (
    plugin,
    cloud_plugin,
    initial_error,
    misplaced_error,
    advice,
    paper,
    types,
    prior,
    aims,
    starts,
    depth,
    cameras,
    confidence,
    harm,
    determined,
    network,
    photos,
    moves,
    brought_back,
    seconds_of_moves,
)
FIGURES += (machine, installation, objects, batches, scale, kernels, record_minutes)
FILLED: dict[str, Callable[[], str]] = {made.__name__: made for made in FIGURES}
FILLED |= {f"{name}_aims_met": partial(aims_met, name) for name in ("accuracy", "speed")}


def with_figures(text: str) -> str:
    """``text`` with every part from ``<!-- NAME -->`` to ``<!-- end -->`` made anew by NAME."""
    return re.sub(
        r"(<!-- (\w+) -->\n).*?(<!-- end -->)",
        lambda m: f"{m[1]}{FILLED[m[2]]()}\n{m[3]}",
        text,
        flags=re.DOTALL,
    )


def _run(command: str, folder: Path) -> str:
    words = shlex.split(command)
    assert words[0] == "tso", command
    words[0:1] = [sys.executable, "-m", "tso_cli"]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    return subprocess.check_output(words, cwd=folder, env=environment, text=True).rstrip("\n")


def _with_commands(text: str, folder: Path) -> str:
    def again(match: re.Match[str]) -> str:
        commands = [command for command, _ in console_commands(match[0])]
        return (
            "```console\n"
            + "".join(f"$ {command}\n{_run(command, folder)}\n" for command in commands)
            + "```"
        )

    return CONSOLE.sub(again, text)


def main(run: bool) -> None:
    for page in PAGES:
        text = with_figures(page.read_text())
        if run:
            with tempfile.TemporaryDirectory() as name:
                working_copy(Path(name))
                text = _with_commands(text, Path(name))
                if page == README:
                    shutil.copy(Path(name) / "chair.png", DOCS / "chair.png")
        page.write_text(text)


if __name__ == "__main__":
    main("--figures" not in sys.argv)
