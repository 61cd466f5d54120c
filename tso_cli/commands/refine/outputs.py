"""The files that `tso refine` writes: one table, which checks, writes and names them."""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from functools import cached_property
from os.path import splitext
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from ...errors import InputError
from ...geometry.arrays import Pixels
from ...io.cameras import CameraRecord, camera_text
from ...io.clouds import NEW, check_suffix, output_suffix, write_cloud
from ...io.output import atomic_output, check_output
from ...refinement import RefineResult
from ...scene.load import Scene
from ..options import require_output
from .inputs import RefineInputs
from .options import RefineOptions

if TYPE_CHECKING:
    from ...plots.recording import Iterates
    from .report import RefineReport


def record_of(result: str) -> str:
    """The name of a result's record."""
    return f"{splitext(result)[0]}.record.json"


@dataclass(frozen=True)
class Finished:
    """A run whose files are written.

    report : makes what page and record say, and the warnings. command : the line for a shell.
    iterates : for --rerun.
    """

    result: RefineResult
    scene: Scene
    inputs: RefineInputs
    report: Callable[[], tuple[RefineReport, list[str]]]
    command: str
    iterates: Iterates | None

    @cached_property
    def photos(self) -> list[Pixels | None]:
        from ...scene.photos import photos_of

        return photos_of(self.scene, self.inputs.view_files, self.inputs.options.fit)


def _write_overlay(path: Path, run: Finished) -> None:
    from ...plots.overlay import draw_overlay

    draw_overlay(path, run.result, run.scene.views, run.photos)


def _write_page(path: Path, run: Finished) -> None:
    from ...plots.page import write_page

    report, warned = run.report()
    write_page(path, run.result, run.scene, run.photos, report.page(warned, run.command))


def _write_recording(path: Path, run: Finished) -> None:
    from ...plots.recording import write_recording

    if run.iterates is not None:
        lines = run.report()[0].summary()
        write_recording(path, run.result, run.scene, run.photos, run.iterates, lines)


def _write_record(path: Path, run: Finished) -> None:
    report, warned = run.report()
    path.write_text(report.record(warned, run.command), encoding="utf-8")


def _write_cameras(path: Path, run: Finished) -> None:
    pairs = zip(run.result.cameras, run.inputs.masks, strict=True)
    records = [CameraRecord(camera, mask) for camera, mask in pairs]
    path.write_text(camera_text(path, records), encoding="utf-8")


def _write_transform(path: Path, run: Finished) -> None:
    document = {
        "matrix": run.result.move.matrix.tolist(),
        "convention": "x' = matrix x, for columns x = (x, y, z, 1) in the units of the cloud",
    }
    path.write_text(json.dumps(document, indent=2) + "\n", encoding="utf-8")


class Output(NamedTuple):
    """word : what the summary calls the file; "" where it does not name it."""

    suffix: str
    word: str
    write: Callable[[Path, Finished], None]


OUTPUTS = {
    "overlay": Output(".png", "picture", _write_overlay),
    "report": Output(".html", "page", _write_page),
    "rerun": Output(".rrd", "", _write_recording),
    "record": Output(".json", "", _write_record),
    "write_camera": Output(".json", "camera", _write_cameras),
    "write_transform": Output(".json", "transform", _write_transform),
}
"""What is written next to the result, by the name of its option."""
NAMED = tuple(name for name in OUTPUTS if name != "record")
"""Those whose names the options say; that of the record follows from that of the result."""


class RefineOutputs:
    """What is written: the result, and the files next to it.

    own_suffix : of the input, if it is written again with other points. record : its name, or None.
    """

    def __init__(self, options: RefineOptions) -> None:
        self.options = options
        self.own_suffix = output_suffix(options.source) if options.mode == "points" else ".ply"
        self.output = options.output or Path(f"{options.source.stem}.refined{self.own_suffix}")
        self.record = Path(record_of(str(self.output))) if options.record else None

    @property
    def others(self) -> dict[str, Path]:
        """The files next to the result that were asked for, by their options."""
        files = {name: getattr(self.options, name) for name in NAMED} | {"record": self.record}
        return {name: files[name] for name in OUTPUTS if files[name] is not None}

    def check(self, inputs: list[Path]) -> None:
        """InputError for an output that cannot be written or would replace another file."""
        check_suffix(self.output, self.own_suffix)
        if self.options.point_confidence and self.output.suffix.lower() != ".ply":
            raise self._of_suffix(".ply to hold --point-confidence")
        if self.options.crop and self.output.suffix.lower() not in NEW:
            raise self._of_suffix(f"{' or '.join(NEW)} for --crop")
        check_output(self.output, self.options.overwrite)
        # A result that replaces its own input is checked by --overwrite.
        taken = {self.output.resolve(): "another file of this command"}
        taken |= {path.resolve(): "an input" for path in inputs}
        for name, file in self.others.items():
            require_output(file, OUTPUTS[name].suffix, self.options.overwrite)
            if whose := taken.get(file.resolve()):
                option = "-o" if name == "record" else f"--{name.replace('_', '-')}"
                raise InputError(f"{file}: is {whose}, expected another name for {option}")
            taken[file.resolve()] = "another file of this command"

    def _of_suffix(self, expected: str) -> InputError:
        return InputError(
            f"{self.output}: the suffix is {self.output.suffix!a}, expected {expected}; write "
            f"another file: -o {self.output.stem}.ply"
        )

    def recorder(self) -> Iterates | None:
        """What keeps the steps for --rerun; fails at once where rerun is not installed."""
        if self.options.rerun is None:
            return None
        import rerun  # noqa: F401

        from ...plots.recording import Iterates

        return Iterates()

    def write(self, run: Finished) -> None:
        """Write all files, or none: the others take their names once the cloud is written."""
        result, overwrite = run.result, self.options.overwrite
        with ExitStack() as stack:
            for name, file in self.others.items():
                OUTPUTS[name].write(stack.enter_context(atomic_output(file, overwrite)), run)
            self.check([])  # before the first of them takes its name
            write_cloud(
                self.output,
                run.scene.to_output(result.points),
                like=run.scene.file,
                overwrite=overwrite,
                matrix=result.move.matrix,
                confidence=result.point_confidence,
                kept=~result.outliers if self.options.crop and result.outliers.any() else None,
            )
