"""The record of `tso bench speed` as tables: for a terminal, and for whoever lays them out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from ...plots.table import Cell, text_table

Records = Sequence[dict[str, Any]]


@dataclass(frozen=True)
class Section:
    """A table: name, what its cells say, header and rows."""

    name: str
    title: str
    header: list[str]
    rows: list[list[Cell]]


def speed_table(record: dict[str, Any]) -> str:
    """All tables, what was left out, what was asked, and the machine."""
    parts = [f"{section.title}\n{text_table(section.header, section.rows)}" for section in sections(record)]
    if left_out := left_out_lines(record["records"]):
        parts.append("left out:\n" + "\n".join(f"  {line}" for line in left_out))
    if record["claims"]:
        claims = [f"{'holds' if c['holds'] else 'does not hold'}: {c['claim']} ({c['found']})" for c in record["claims"]]
        parts.append("\n".join(claims))
    parts.append(machine_line(record))
    return "\n\n".join(parts)


def machine_line(record: dict[str, Any]) -> str:
    """Where and with what it was measured."""
    machine, versions = record["machine"], record["versions"]
    on = f"{machine['gpu']}, {machine['cpu']}" if machine["gpu"] else machine["cpu"]
    named = ", ".join(f"{name} {version}" for name, version in versions.items() if version)
    threads = f"{record['threads']} thread{'s' if record['threads'] > 1 else ''}"
    run = f"seed {record['seed']}, {record['seconds']:.0f} s"
    return f"{on}, {machine['cores']} cores, {threads}, {record['device']}; {named}; {run}"


def left_out_lines(records: Records) -> list[str]:
    """Contestants without a measurement, and why."""
    reasons: dict[tuple[str, str], list[str]] = {}
    for record in records:
        if reason := record.get("left_out"):
            size = "" if record["points"] is None else f" ({_size(record)})"
            reasons.setdefault((record["what"], record["name"]), []).append(reason + size)
    return [f"{what}, {name}: {'; '.join(found)}" for (what, name), found in reasons.items()]


def sections(record: dict[str, Any]) -> list[Section]:
    """The tables of whatever was measured."""
    records = record["records"]
    made = [
        _rates(records),
        _pivot(
            "silhouette",
            "silhouette, forward and backward: ms (x tso's)",
            [r for r in records if r["what"] in ("silhouette", "limit")],
            lambda r: _ms(r) if r["what"] == "limit" else _time_and("over_tso")(r),
            lambda r: f"limit: {r['name']}" if r["what"] == "limit" else r["name"],
        ),
        _pivot("profile", "stages of the compiled silhouette: ms (share of the whole)", _of(records, "profile"), _shared),
        _growth(records),
        _pivot("chamfer", "Chamfer to the start, a step: ms (x tso's)", _of(records, "chamfer"), _time_and("over_tso")),
        _pivot(
            "memory",
            "peak memory of a call: MiB",
            [r for r in records if r["peak_memory_bytes"] is not None],
            lambda r: f"{r['peak_memory_bytes'] / 2**20:,.1f}",
            lambda r: f"{r['what']}: {r['name']}",
            lambda r: f"{r['points']:,}",
        ),
        _pivot("terms", "value and gradient: ms (x the projector)", _of(records, "terms"), _time_and("over_projector")),
        _pivot("step", "a step in points mode: ms (share of the whole)", _of(records, "step"), _shared),
        _network(records),
        _forms(records),
        _batch(records),
        _threads(records),
        _training_rates(records),
        _training(records),
        _start_up(records),
    ]
    return [section for section in made if section.rows]


def _of(records: Records, what: str) -> Records:
    return [record for record in records if record["what"] == what]


def _size(record: dict[str, Any]) -> str:
    return f"{record['points']:,}" + (f"@{record['side']}" if record["side"] else "")


def _ms(record: dict[str, Any]) -> str:
    return f"{_digits(1e3 * record['seconds']['median'])}"


def _digits(value: float) -> str:
    """Three digits, none in powers of ten."""
    return f"{value:,.0f}" if value >= 100 else f"{value:.3g}"


def _time_and(ratio: str) -> Callable[[dict[str, Any]], str]:
    def cell(record: dict[str, Any]) -> str:
        return _ms(record) + (f" ({_digits(record[ratio])}x)" if record.get(ratio) is not None else "")

    return cell


def _shared(record: dict[str, Any]) -> str:
    return f"{_ms(record)} ({100.0 * record['share']:.0f} %)"


def _pivot(
    name: str,
    title: str,
    records: Records,
    cell: Callable[[dict[str, Any]], str],
    label: Callable[[dict[str, Any]], str] = lambda record: record["name"],
    column: Callable[[dict[str, Any]], str] = _size,
) -> Section:
    """A row for each contestant, a column for each size."""
    measured = [record for record in records if record["seconds"]]
    sizes = list(dict.fromkeys(column(record) for record in measured))
    cells: dict[str, dict[str, str]] = {}
    for record in measured:
        cells.setdefault(label(record), {})[column(record)] = cell(record)
    rows: list[list[Cell]] = [[row, *(own.get(size) for size in sizes)] for row, own in cells.items()]
    return Section(name, title, ["", *sizes], rows)


def _rates(records: Records) -> Section:
    rows: list[list[Cell]] = [[r["name"], f"{r['per_second'] / 1e9:.1f}", r["unit"]] for r in _of(records, "rate")]
    return Section("rate", "what the machine does, float32", ["", "10^9 a second", "of"], rows)


def _growth(records: Records) -> Section:
    rows: list[list[Cell]] = []
    for by in ("points", "pixels"):
        found = _of(records, f"growth, {by}")
        if found:
            times = ", ".join(f"{_size(record)} {_ms(record)}" for record in found)
            rows.append([by, times, f"{found[0]['slope']:.2f}", f"{found[0]['steepest']:.2f}"])
    return Section("growth", "growth of the cost in log-log", ["against", "ms", "slope", "steepest"], rows)


def _network(records: Records) -> Section:
    rows: list[list[Cell]] = []
    for mode in ("encoder", "encoder-decoder"):
        found = {record["name"]: record for record in _of(records, f"step, {mode}")}
        if found:
            bare, whole = found["bare network"], found["whole step"]
            rows.append([mode, _ms(bare), _ms(whole), f"{100.0 * whole['added']:.0f} %"])
    return Section("network", "a step in the network modes: ms", ["mode", "bare network", "whole step", "added"], rows)


def _forms(records: Records) -> Section:
    rows: list[list[Cell]] = [[record["name"], _ms(record)] for record in _of(records, "network forms")]
    return Section("network forms", "a step of the network on one image, taken apart: ms", ["", "ms"], rows)


def _batch(records: Records) -> Section:
    rows: list[list[Cell]] = [
        [r["preset"], r["name"], str(r["batch"]), _ms(r), _digits(r["clouds_per_second"]), f"{r['times_refine']:.1f}x"]
        for r in _of(records, "batch")
    ]
    header = ["preset", "call", "clouds", "ms a cloud", "clouds a second", "x `refine`"]
    return Section("batch", "clouds of 1,024 points, all steps and what is around them", header, rows)


def _threads(records: Records) -> Section:
    found = _of(records, "threads")
    counts = list(dict.fromkeys(record["threads"] for record in found))
    rows: list[list[Cell]] = []
    for name in dict.fromkeys(record["name"] for record in found):
        own = [record for record in found if record["name"] == name]
        rows.append([name, _size(own[0]), *(_ms(record) for record in own), f"{own[-1]['over_first']:.2f}x"])
    header = ["", "points", *(f"{count} thread{'s' if count > 1 else ''}" for count in counts), "quicker"]
    return Section("threads", "the same work on more threads: ms", header, rows)


def _training_rates(records: Records) -> Section:
    rows: list[list[Cell]] = [
        [r["name"], r["precision"], f"{r['per_second'] / 1e9:.1f}"] for r in _of(records, "training rate")
    ]
    return Section("training rate", "what the roofline is made of", ["", "precision", "10^9 multiply-adds a second"], rows)


def _training(records: Records) -> Section:
    rows: list[list[Cell]] = []
    for supervision in ("points", "masks"):
        found = _of(records, f"training, {supervision}")
        for bare, whole in zip(found[::2], found[1::2], strict=True):
            speeds = [_digits(record["images_per_second"]) for record in (bare, whole)]
            reached = f"{_digits(whole['roofline'])} ({100.0 * whole['images_per_second'] / whole['roofline']:.0f} %)"
            shares = [f"{100.0 * whole[key]:.{digits}f} %" for key, digits in (("added", 0), ("waiting", 1))]
            rows.append([supervision, bare["precision"], *speeds, shares[0], reached, shares[1]])
    header = ["supervision", "precision", "bare network, images/s", "step, images/s", "added", "roofline, images/s (reached)"]
    header.append("waits for data")
    return Section("training", "training: images a second", header, rows)


def _start_up(records: Records) -> Section:
    rows: list[list[Cell]] = [
        [r["name"], *(f"{r['seconds'][key]:.2f}" for key in ("median", "low", "high"))] for r in _of(records, "start-up")
    ]
    return Section("start-up", "whole processes: s", ["", "median", "low", "high"], rows)
