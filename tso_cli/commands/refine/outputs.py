"""The files that `tso refine` writes: one table, which checks, writes and names them."""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import ExitStack
from os.path import splitext
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import click

from ...errors import InputError
from ...io.cameras import CameraRecord, camera_text
from ...io.clouds import NEW, check_suffix, output_suffix, write_cloud
from ...io.output import atomic_output, check_output
from ..options import require_output
from .options import RefineOptions
from .report import RefineReport

if TYPE_CHECKING:
    from ...plots.recording import Iterates


def own_suffix(source: Path, mode: str) -> str:
    """The suffix of the input, if it is written again with other points."""
    return output_suffix(source) if mode == "points" else ".ply"


def record_of(result: str) -> str:
    """The name of a result's record."""
    return f"{splitext(result)[0]}.record.json"


def _write_overlay(path: Path, report: RefineReport) -> None:
    from ...plots.overlay import draw_overlay

    draw_overlay(path, report.result, report.scene.views, report.photos)


def _write_page(path: Path, report: RefineReport) -> None:
    from ...plots.page import write_page

    write_page(path, report.result, report.scene, report.photos, report.page())


def _write_recording(path: Path, report: RefineReport) -> None:
    from ...plots.recording import write_recording

    result, scene, lines = report.result, report.scene, report.summary()
    if report.iterates is not None:
        write_recording(path, result, scene, report.photos, report.iterates, lines)


def _write_record(path: Path, report: RefineReport) -> None:
    path.write_text(report.record(), encoding="utf-8")


def _write_cameras(path: Path, report: RefineReport) -> None:
    pairs = zip(report.result.cameras, report.inputs.masks, strict=True)
    records = [CameraRecord(camera, mask) for camera, mask in pairs]
    path.write_text(camera_text(path, records), encoding="utf-8")


def _write_transform(path: Path, report: RefineReport) -> None:
    document = {
        "matrix": report.result.move.matrix.tolist(),
        "convention": "x' = matrix x, for columns x = (x, y, z, 1) in the units of the cloud",
    }
    path.write_text(json.dumps(document, indent=2) + "\n", encoding="utf-8")


class Output(NamedTuple):
    """A kind of extra file; ``word`` is its name in the summary, "" where it is not there."""

    suffix: str
    word: str
    write: Callable[[Path, RefineReport], None]


OUTPUTS = {
    "overlay": Output(".png", "picture", _write_overlay),
    "report": Output(".html", "page", _write_page),
    "rerun": Output(".rrd", "", _write_recording),
    "record": Output(".json", "", _write_record),
    "write_camera": Output(".json", "camera", _write_cameras),
    "write_transform": Output(".json", "transform", _write_transform),
}
"""What is written next to the result, by the name of its option."""
WITH_PHOTOS = {"overlay", "report", "rerun"}
NAMED = tuple(name for name in OUTPUTS if name != "record")
"""Outputs whose file the user names. The record is named after the result."""


class RefineOutputs:
    """What is written: the result and the extra files, each by the name of its option."""

    def __init__(self, options: RefineOptions) -> None:
        self.options = options
        self._suffix = own_suffix(options.source, options.mode)
        self.output = options.output or Path(f"{options.source.stem}.refined{self._suffix}")
        files = {name: getattr(options, name) for name in NAMED}
        files["record"] = Path(record_of(str(self.output))) if options.record else None
        self.extra_files: dict[str, Path] = {
            name: files[name] for name in OUTPUTS if files[name] is not None
        }
        self.files = {"output": self.output, **self.extra_files}

    def check(self, inputs: list[Path], config: Path | None = None) -> None:
        """InputError for an output that cannot be written or would replace another file.

        No output replaces the ``config``, but a record may replace the record that the run repeats.
        """
        check_suffix(self.output, self._suffix)
        for is_asked, suffixes, why in (
            (self.options.point_confidence, (".ply",), "to hold --point-confidence"),
            (self.options.crop, NEW, "for --crop"),
        ):
            if is_asked and self.output.suffix.lower() not in suffixes:
                raise InputError(
                    f"{self.output}: the suffix is {self.output.suffix!a}, expected "
                    f"{' or '.join(suffixes)} {why}; write another file: -o {self.output.stem}.ply"
                )
        check_output(self.output, self.options.overwrite)
        # A result that replaces its own input is checked by --overwrite.
        owners = {self.output.resolve(): "another file of this command"}
        owners |= {path.resolve(): "an input" for path in inputs}
        if config is not None:
            owners[config.resolve()] = "the file of --config"
        for name, file in self.extra_files.items():
            require_output(file, OUTPUTS[name].suffix, self.options.overwrite)
            owner = owners.get(file.resolve())
            if owner and not (name == "record" and owner == "the file of --config"):
                option = "-o" if name == "record" else f"--{name.replace('_', '-')}"
                raise InputError(f"{file}: is {owner}, expected another name for {option}")
            owners[file.resolve()] = "another file of this command"

    def recorder(self) -> Iterates | None:
        """What keeps the steps for --rerun; fails at once where rerun is not installed."""
        if self.options.rerun is None:
            return None
        import rerun  # noqa: F401

        from ...plots.recording import Iterates

        return Iterates()

    def write(self, report: RefineReport) -> None:
        """Write all files, or none: the others take their names once the cloud is written."""
        result, scene, overwrite = report.result, report.scene, self.options.overwrite
        with ExitStack() as stack:
            for name, file in self.extra_files.items():
                OUTPUTS[name].write(stack.enter_context(atomic_output(file, overwrite)), report)
            self.check([])  # before the first of them takes its name
            write_cloud(
                self.output,
                scene.to_output(result.points),
                like=scene.file,
                overwrite=overwrite,
                matrix=result.move.matrix,
                confidence=result.point_confidence,
                kept=~result.outliers if self.options.crop and result.outliers.any() else None,
            )

    def print_names(self) -> None:
        """Name the files next to the result that `Output` has a word for."""
        for name, file in self.extra_files.items():
            if word := OUTPUTS[name].word:
                click.echo(f"{file}: {word}")
