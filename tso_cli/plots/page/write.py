"""The page: its sections, in the order of a reader's questions.

Everything that comes from files, names or the command goes through `text` or into JSON whose "<"
are escaped.
"""

from __future__ import annotations

import base64
import hashlib
import html
import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...geometry.arrays import Pixels
from ...refinement import RefineResult
from ...scene.load import Scene
from ..overlay import COLOURS
from .pictures import pictures_of
from .solid import solid_of

FOLDER = Path(__file__).parent
# Colours of what is drawn as outlines and points; safe for colour-blind readers.
LINES = {"mask": "#f0e442", "start": "#d1559c", "result": "#00a878"}
NAMES = {"mask": "outline of the mask", "start": "start", "result": "result"}
# Settings that the page lists, by their names in the JSON document.
SETTINGS = (
    "mode", "preset", "moving", "points", "outliers", "steps", "best_step", "stop_reason",
    "moved", "learning_rate", "gamma", "sigma_sq", "device", "checkpoint", "assume", "frame",
    "output", "version",
)  # fmt: skip


@dataclass(frozen=True)
class PageWords:
    """What the command says of a result.

    title : the name of the input. written : the line about the output. lines : the lines "IoU" and
    "moved". used : the parts of the line "used", the time at last. verdict : what the verdict
    means. reason : why the result is doubtful or has no confidence. mirror : the mirror plane.
    command : to copy. document : of --json.
    """

    title: str
    written: str
    lines: dict[str, str]
    used: Sequence[str]
    verdict: str
    reason: str
    warnings: Sequence[str]
    mirror: str
    command: str
    document: dict[str, Any]


def write_page(
    path: Path,
    result: RefineResult,
    scene: Scene,
    photos: Sequence[Pixels | None],
    words: PageWords,
) -> None:
    """Write the page of a result to ``path``. It loads nothing from elsewhere.

    ``photos`` [h, w, 3] are the whole images of the views, or None.
    """
    pictures = pictures_of(result, scene.views, photos)
    solid = solid_of(result, scene)
    solid["backdrops"] = {str(picture["number"]): picture["box"] for picture in pictures}
    document = words.document
    main = "".join([
        f"<header><p class=kind>tso refine</p><h1>{text(words.title)}</h1>",
        f"<p class=written>{text(words.written)}</p></header>",
        _answers(document, words, solid),
        _solid_section(solid, pictures),
        _views_section(document, pictures),
        _details(document, words),
    ])  # fmt: skip
    body = (
        f"<main>{main}</main>\n"
        f'<script type="application/json" id="solid">{as_json(solid)}</script>\n'
        f"<!--\n{_read('three.LICENSE')}-->\n"
    )
    page = html_page(
        f"{text(words.title)}: tso refine",
        f"{_variables()}\n{_read('page.css')}",
        body,
        [_read("three.min.js"), _read("page.js")],
        images="data: blob:",
    )
    # Names of files may hold bytes that are not UTF-8.
    path.write_text(page, encoding="utf-8", errors="backslashreplace", newline="\n")


def html_page(title: str, style: str, body: str, scripts: Sequence[str], images: str) -> str:
    """A page that runs these ``scripts`` alone, and loads ``images`` from these sources alone."""
    digests = [base64.b64encode(hashlib.sha256(s.encode()).digest()).decode() for s in scripts]
    allowed = " ".join(f"'sha256-{digest}'" for digest in digests)
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">\n'
        '<meta http-equiv="Content-Security-Policy" content="default-src \'none\'; '
        f"script-src {allowed}; style-src 'unsafe-inline'; img-src {images}\">\n"
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{title}</title>\n<style>{style}</style></head>\n<body>\n{body}"
        + "".join(f"<script>{script}</script>\n" for script in scripts)
        + "</body></html>\n"
    )


def text(value: Any) -> str:
    """A value as text of HTML; safe in attributes too."""
    return html.escape(str(value), quote=True).replace(" %", "\u00a0%")


def as_json(value: Any) -> str:
    """JSON that cannot end the script element that holds it."""
    dumped = json.dumps(value, separators=(",", ":"), allow_nan=False)
    return dumped.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _read(name: str) -> str:
    return (FOLDER / name).read_text(encoding="utf-8")


def _variables() -> str:
    """The colours that Python knows, for the style sheet."""
    lines = "".join(f"--{name}:{colour};" for name, colour in LINES.items())
    for name, colour in COLOURS.items():
        red, green, blue = (round(255 * channel) for channel in colour)
        lines += f"--{name.replace(' ', '-')}:rgb({red},{green},{blue});"
    return f":root{{{lines}}}"


def _answers(document: dict[str, Any], words: PageWords, solid: dict[str, Any]) -> str:
    verdict = document["verdict"] or "no confidence"
    kind = (document["verdict"] or "none").replace(" ", "-")
    better = f'<p><span class="badge {kind}">{text(verdict)}</span></p><p>{text(words.verdict)}</p>'
    before, after = document["iou_before"], document["iou_after"]
    much = (
        f"<div class=bars>{_bar('start', before)}{_bar('result', after)}</div>"
        f"<p><b>IoU</b> {text(words.lines['IoU'])}.</p>"
        f"<p><b>Moved</b> {text(words.lines['moved'])}.{_drawn(document, solid)}</p>"
    )
    *assumptions, seconds = words.used
    items = "".join(f"<li>{text(assumption)}</li>" for assumption in assumptions)
    return (
        "<section class=answers>"
        f"<article><h2>Did it get better?</h2>{better}</article>"
        f"<article><h2>By how much?</h2>{much}</article>"
        f"<article><h2>Can I trust it?</h2>{_trust(document, words)}</article>"
        f"<article><h2>What did it assume?</h2><ul>{items}</ul>"
        f"<p class=quiet>Took {text(seconds)} until this page was written.</p></article>"
        "</section>"
    )


def _drawn(document: dict[str, Any], solid: dict[str, Any]) -> str:
    """Why the colour scale has another largest displacement than the line "moved"."""
    largest = f"{100.0 * solid['largest']:.1f} %"
    if largest == f"{100.0 * document['moved_max']:.1f} %":
        return ""
    kind = "vertices" if solid["kind"] == "mesh" else "points"
    return text(f" That is of the control points; the {kind} below move by {largest} at most.")


def _bar(name: str, share: float | None) -> str:
    share = share or 0.0
    return (
        f"<div class=bar><span>{NAMES[name]}</span><span class=track>"
        f'<span class=fill style="width:{100 * share:.1f}%;background:var(--{name})"></span>'
        f"</span><b>{share:.3f}</b></div>"
    )


def _trust(document: dict[str, Any], words: PageWords) -> str:
    parts = []
    confidence = document["confidence"]
    if confidence is not None:
        # What harm is, the verdict says.
        meaning = "probability that the displacement does not harm the cloud"
        short = f"{confidence:.4f}"[:4]
        parts.append(
            f'<p class=number>{short}</p><meter min=0 max=1 low=0.5 value="{confidence:.4f}" '
            f'aria-label="confidence {short}"></meter><p><b>Confidence</b>: {meaning}.</p>'
        )
    if words.reason and not any(words.reason in warning for warning in words.warnings):
        parts.append(f"<p><b>Reason</b>: {text(words.reason)}.</p>")
    if words.warnings:
        items = "".join(f"<li>{text(warning)}</li>" for warning in words.warnings)
        parts.append(f'<p><b>Warnings</b></p><ul class="warnings">{items}</ul>')
    else:
        parts.append("<p>Nothing suspicious was found in the input.</p>")
    return "".join(parts)


def _check(name: str, words: str, on: bool, key: str = "") -> str:
    swatch = f'<span class=swatch style="background:var(--{key})"></span>' if key else ""
    return (
        f'<label><input type=checkbox id="{name}"{" checked" if on else ""}>{swatch}{words}</label>'
    )


def _solid_section(solid: dict[str, Any], pictures: Sequence[dict[str, Any]]) -> str:
    mesh = solid["kind"] == "mesh"
    coloured = bool(solid.get("colours") or solid.get("textures")) or any(
        solid.get(name) for name in ("faceColours", "vertexColours")
    )
    own = "texture" if solid.get("textures") else "colours of the file"
    choices = [("moved", "displacement"), ("plain", "one colour each")]
    choices += [("own", own)] if coloured else []
    radios = "".join(
        f'<label><input type=radio name=colour value="{value}"{" checked" if not i else ""}>'
        f"{label}</label>"
        for i, (value, label) in enumerate(choices)
    )
    largest = 100.0 * solid["largest"]
    legend = (
        "<div id=scale class=scale><span>displacement, % of the object&#39;s size</span>"
        '<span class=ramp role=img aria-label="colour scale from blue, 0 %, over green to pale '
        f'yellow, {largest:.1f} %"></span><span class=ends><span>0 %</span>'
        f"<span>{largest / 2:.1f} %</span><span>{largest:.1f} %</span></span></div>"
    )
    names = [camera["name"] for camera in solid["cameras"]]
    if len(names) <= 6:
        looks = "".join(
            f'<button type=button class=look data-view="{i}" title="{text(name)}">'
            f"Look through camera {i + 1}</button>"
            for i, name in enumerate(names)
        )
    else:
        options = "".join(
            f'<option value="{i}">{i + 1}: {text(Path(name).name)}</option>'
            for i, name in enumerate(names)
        )
        looks = (
            f'<label>Camera <select id=which aria-label="camera">{options}</select></label>'
            "<button type=button class=look>Look through it</button>"
        )
    backdrop = _check("backdrop", "picture behind", True) if pictures else ""
    notes = "".join(f"<p class=quiet>{text(note)}</p>" for note in solid["notes"])
    what = "Meshes" if mesh else "Points"
    return (
        "<section class=solid-section><h2>In three dimensions</h2><div class=solid>"
        "<div class=controls>"
        f"<fieldset><legend>Show</legend>{_check('show-result', 'result', True, 'result')}"
        f"{_check('show-start', 'start', True, 'start')}"
        f"{_check('show-cameras', 'cameras', False)}</fieldset>"
        f"<fieldset><legend>Colour of the result</legend>{radios}</fieldset>"
        f"<fieldset><legend>Look</legend>{looks}{backdrop}"
        "<button type=button id=reset>Reset</button></fieldset></div>"
        '<div class=stage><canvas id=canvas tabindex=0 role=img aria-label="'
        f"{what} before and after, which can be turned. Arrow keys rotate, plus and minus zoom, 0 "
        f'resets."></canvas><p id=said class=said role=status></p>{legend}</div></div>'
        "<p class=quiet>Drag to rotate, use the wheel or two fingers to zoom. With the keyboard: "
        "arrow keys, plus, minus, and 0 to reset. Lengths are relative to the object&#39;s "
        f"longest side.</p>{notes}</section>"
    )


def _views_section(document: dict[str, Any], pictures: Sequence[dict[str, Any]]) -> str:
    views = document["views"]
    several = len(views) > 1
    photo = any(picture["photo"] for picture in pictures)
    checks = (
        _check("line-mask", NAMES["mask"], True, "mask")
        + _check("line-start", "silhouette of the start", True, "start")
        + _check("line-result", "silhouette of the result", True, "result")
        + (_check("photo", "photo", True) if photo else "")
    )
    selection = ""
    if len(pictures) < len(views):
        selection = f"<p class=quiet>{len(pictures)} of {len(views)} views, evenly chosen.</p>"
    cards = "".join(_card(views[p["number"]], p, several) for p in pictures)
    unknown = any(picture["unknown"] for picture in pictures)
    legend = "".join(
        f'<span><span class=swatch style="background:var(--{key.replace(" ", "-")})"></span>{words}'
        "</span>"
        for key, words in (
            ("agree", "mask and silhouette agree"),
            ("mask without silhouette", "missing: mask without silhouette"),
            ("silhouette without mask", "extra: silhouette without mask"),
            ("unknown", "unknown"),
        )
        if key != "unknown" or unknown
    )
    heading = "Each view against its mask" if several else "The view against its mask"
    kind = "many" if several else "one"
    return (
        f"<section><h2>{heading}</h2><div class=controls><fieldset><legend>Outlines</legend>"
        f"{checks}</fieldset></div><p class=legend>{legend}</p>{selection}"
        f'<div class="cards {kind}">{cards}</div></section>'
    )


def _card(view: dict[str, Any], picture: dict[str, Any], several: bool) -> str:
    number, name = picture["number"] + 1, text(Path(view["mask"]).name)
    width, height = picture["width"], picture["height"]
    iou = f"IoU {view['iou_before']:.3f} -> {view['iou_after']:.3f}"
    iou += f", weight {view['inlier_weight']:.2f}" if several else ""
    what = "Photo" if picture["photo"] else "Mask"
    paths = "".join(
        f'<path class="halo line-{key}" d="{path}"/><path class="line line-{key}" '
        f'style="stroke:var(--{key})" d="{path}"/>'
        for key, path in picture["outlines"].items()
    )
    part = ""
    if picture["part"]:
        left, top, right, bottom = picture["part"]
        part = f"Columns {left} to {right - 1}, rows {top} to {bottom - 1}. "
    figures = ""
    for stage, difference in zip(("Start", "Result"), picture["differences"], strict=True):
        missing, extra = (100 * difference[name] for name in ("missing", "extra"))
        shares = f"{missing:.1f} % of the mask missing, {extra:.1f} % extra"
        figures += (
            f'<figure><img src="{difference["uri"]}" width="{difference["width"]}" '
            f'height="{difference["height"]}" alt="{stage}, view {number}: {shares}">'
            f"<figcaption>{stage}: {shares}</figcaption></figure>"
        )
    return (
        f"<article class=view><h3>View {number}: {name}</h3>"
        f"<p>{iou}</p>"
        f'<div class=panels><figure class=outlines><svg viewBox="0 0 {width} {height}" role=img '
        f'aria-label="{what} of view {number} with the outlines of mask, start and result">'
        f'<rect class=paper width="{width}" height="{height}"/>'
        f'<image {"class=photo " if picture["photo"] else ""}id="base-{picture["number"]}" '
        f'href="{picture["base"]}" width="{width}" height="{height}"/>{paths}</svg>'
        f"<figcaption>{what}. {part}</figcaption></figure>"
        f"<div class=differences>{figures}</div></div></article>"
    )


def _table(header: Sequence[str], rows: Iterable[Iterable[Any]]) -> str:
    """A table. In a narrow window the cells of more than two columns are below each other."""
    head = "".join(f"<th scope=col>{text(name)}</th>" for name in header)
    lines = "".join(
        "<tr>"
        + "".join(
            f'<td data-name="{text(name)}">{text(cell)}</td>'
            for name, cell in zip(header, row, strict=True)
        )
        + "</tr>"
        for row in rows
    )
    kind = " class=stacked" if len(header) > 2 else ""
    table = f"<table{kind}><thead><tr>{head}</tr></thead><tbody>{lines}</tbody></table>"
    return f"<div class=scroll>{table}</div>"


def _details(document: dict[str, Any], words: PageWords) -> str:
    views = _table(
        ("view", "IoU before", "IoU after", "inlier weight", "camera"),
        (
            (
                view["mask"],
                f"{view['iou_before']:.3f}",
                f"{view['iou_after']:.3f}",
                f"{view['inlier_weight']:.2f}",
                view["camera"]["source"],
            )
            for view in document["views"]
        ),
    )
    suspects = document["suspects"]
    suspicious = ""
    if suspects:
        rows = (
            (
                suspect["what"],
                suspect["option"],
                f"{suspect['score']:.3f}" if suspect["score"] else "-",
            )
            for suspect in suspects
        )
        table = _table(("what may be wrong", "what to try", "IoU then"), rows)
        suspicious = f"<h3>Findings</h3>{table}"
    settings = _table(
        ("setting", "value"),
        (*((name, _shown(document.get(name))) for name in SETTINGS), ("mirror", words.mirror)),
    )
    seconds = _table(
        ("phase", "seconds"), ((k, f"{v:.3f}") for k, v in document["seconds"].items())
    )
    dumped = json.dumps(document, indent=2, allow_nan=False)
    conventions = "".join(
        f"<dt>{text(name)}</dt><dd>{text(meaning)}</dd>"
        for name, meaning in document["convention"].items()
    )
    return (
        "<section><h2>Details</h2>"
        f"<h3>Views</h3>{views}{suspicious}"
        f"<h3>Loss</h3>{_losses(document)}"
        f"<h3>Command</h3><div class=copy><pre id=command>{text(words.command)}</pre>"
        '<button type=button data-copy="command">Copy</button></div>'
        f"<div class=two><details open><summary>Settings</summary>{settings}</details>"
        f"<details open><summary>Seconds</summary>{seconds}</details></div>"
        f"<details><summary>What the terms mean</summary><dl>{conventions}</dl></details>"
        "<details><summary>Everything as JSON</summary><div class=copy>"
        f'<pre id=json>{text(dumped)}</pre><button type=button data-copy="json">Copy</button></div>'
        "</details></section>"
    )


def _shown(value: Any) -> str:
    if value is None or value == []:
        return "none"
    if isinstance(value, list):
        return ", ".join(map(str, value))
    return f"{value:g}" if isinstance(value, float) else str(value)


def _losses(document: dict[str, Any]) -> str:
    """The loss after each step as a line."""
    before, after = document["loss_before"], document["loss_after"]
    losses = [loss for loss in document["losses"] if loss is not None]
    numbers = "not a number" if None in (before, after) else f"{before:.4g} -> {after:.4g}"
    caption = f"From start to result {numbers}: {document['convention']['loss']}."
    if len(losses) < 2:
        return f"<p>{text(caption)}</p>"
    low, high = min(0.0, *losses), max(losses)
    span = (high - low) or 1.0
    line = " ".join(
        f"{600 * i / (len(losses) - 1):.1f},{140 - 130 * (loss - low) / span:.1f}"
        for i, loss in enumerate(losses)
    )
    return (
        f'<svg class=chart viewBox="0 0 600 150" role=img preserveAspectRatio=none '
        f'aria-label="loss where the optimisation begins and after {len(losses) - 1} steps">'
        f'<path d="M0 140H600" class=axis /><polyline points="{line}"/></svg>'
        "<p class=ends><span>where the optimisation begins</span>"
        f"<span>step {len(losses) - 1}</span></p>"
        f"<p class=quiet>{text(caption)}</p>"
    )
