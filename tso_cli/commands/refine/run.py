"""One run of `tso refine`: files in, result, files and words out."""

from __future__ import annotations

import sys
import time
import warnings
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from ...diagnosis.assumptions import left_handed
from ...diagnosis.examine import NoOverlapError
from ...errors import GateError, InputError
from ...geometry.arrays import Array, Pixels
from ...io.reading import require_memory
from ...refinement import RefineResult, refine
from .. import options
from .check import check_scene
from .inputs import RefineInputs
from .options import RefineOptions
from .outputs import WITH_PHOTOS, RefineOutputs
from .report import RefineReport
from .sentences import Words

# Memory of one control point.
BYTES_OF_A_CONTROL_POINT = 1100
LEFT = 4
"""The exit code with --strict where the cloud is written as it was."""
INTERRUPTED = 130
"""The exit code after Ctrl-C."""


class RefineRun:
    """What the options ask for, read and checked.

    ``given`` are those of the ``options`` that were not left to their defaults. ``warned`` collects
    the warnings of the run. ``line`` is the command for a shell.
    """

    def __init__(
        self, chosen: RefineOptions, given: Mapping[str, Any], warned: list[str], line: str
    ) -> None:
        self._started = time.perf_counter()
        self._options, self._given, self._warned, self._line = chosen, given, warned, line
        self._inputs, self._outputs = RefineInputs(chosen), RefineOutputs(chosen)
        if not chosen.check:
            self._outputs.check(self._inputs.files)
        self._iterates = None if chosen.check else self._outputs.recorder()
        self._scene = self._inputs.load()
        if chosen.verbose or (chosen.check and not chosen.quiet):
            if self._inputs.checkpoint is not None:
                options.log(f"tso: checkpoint: {self._inputs.checkpoint}")
            options.log(f"tso: camera: {', '.join(dict.fromkeys(self._scene.camera_sources))}")
        of_paper = chosen.sigma_sq is None and chosen.preset == "paper"
        self._config = chosen.config(**{"sigma_sq": self._scene.sigma_sq} if of_paper else {})
        self._settings = self._config.settings()
        self._words = Words(
            [view.name for view in self._scene.views],
            chosen.invert_mask,
            [str(file) for file in chosen.depth],
            chosen.depth_scale or 1.0,
            may_turn=self._settings.move in ("auto", "shape"),
            accepting=self._settings.accept_doubtful,
        )

    def check(self) -> int:
        """Examine the input alone; the exit code."""
        chosen = self._options
        reason = check_scene(
            self._scene, self._settings, self._words, self._warned, chosen.as_json, chosen.quiet
        )
        if reason and chosen.strict:
            raise GateError(f"{chosen.source}: the result would be doubtful: {reason}")
        return 0

    def refine(self) -> int:
        """Refine, write the files and print the result; the exit code."""
        chosen, report = self._options, self.work()
        result = report.result
        if chosen.as_json:
            options.echo_json(report.document())
        if not report.files:
            raise GateError(
                f"{chosen.source}: the result is {result.trust.verdict or 'without confidence'}: "
                f"{self._words.reason(result)}; with --strict nothing is written"
            )
        if not chosen.as_json and not chosen.quiet:
            report.print_summary()
            self._outputs.print_names()
            if chosen.verbose:
                report.print_details()
        if result.fit.stop_reason == "interrupted":
            return INTERRUPTED
        return LEFT if chosen.strict and not result.moved else 0

    def work(self) -> RefineReport:
        """Refine and write the files; with --strict, a doubtful result has none."""
        self._require_writable_cameras()
        read = time.perf_counter()
        result = self._refined()
        refined = time.perf_counter()
        refused = self._options.strict and result.trust.verdict in ("doubtful", None)
        files = {} if refused else self._outputs.files
        with_photos = not WITH_PHOTOS.isdisjoint(files)
        sentences = self._words.warnings(result, refused)
        seconds = {"read": read - self._started, **result.cost.seconds}
        report = RefineReport(
            result=result,
            scene=self._scene,
            inputs=self._inputs,
            words=self._words,
            given=self._given,
            command=self._line,
            files=files,
            photos=self._photos() if with_photos else [],
            iterates=self._iterates,
            seconds={**seconds, "total": refined - self._started},
            warnings=[*self._warned, *sentences],
        )
        if not refused:
            self._outputs.write(report)
        written = time.perf_counter()
        for sentence in sentences:
            warnings.warn(sentence, stacklevel=1)
        seconds |= {"write": written - refined, "total": written - self._started}
        return replace(report, seconds=seconds, warnings=self._warned)

    def _photos(self) -> list[Pixels | None]:
        from ...scene.photos import photos_of

        return photos_of(self._scene, self._inputs.view_files, self._options.fit)

    def _require_writable_cameras(self) -> None:
        """Refuse to write the cameras of a cloud with left-handed axes."""
        path = self._options.write_camera
        if path and left_handed(self._scene.given.assumptions):
            raise InputError(
                f"--write-camera {path}: the cloud has left-handed axes, which no camera has; "
                f"found --assume {' '.join(self._options.assume)}, expected a cloud with "
                "right-handed axes"
            )

    def _refined(self) -> RefineResult:
        """The result, with a progress bar on a terminal."""
        scene, source, given = self._scene, self._options.source, self._scene.given
        points_mode = self._options.mode == "points"
        if points_mode and self._settings.points is None:
            require_memory(source, BYTES_OF_A_CONTROL_POINT * len(scene.points))
        bar, iterates = options.ProgressBar("tso: refining"), self._iterates
        has_bar = sys.stderr.isatty() and not self._options.quiet

        def on_progress(step: int, total: int, loss: float, points: Array) -> None:
            if has_bar:
                bar(step, total, f"steps, loss {loss:.6g}" if self._options.verbose else "steps")
            if iterates is not None:
                iterates.add(step, loss, points)

        try:
            with options.naming(source):
                return refine(
                    given.cloud if points_mode else None,
                    given.read,
                    config=self._config,
                    assume=given.assumptions,
                    network=scene.network,
                    image=scene.image,
                    known=given.known,
                    progress=on_progress if has_bar or iterates is not None else None,
                )
        except NoOverlapError as error:
            raise self._words.no_overlap(error) from None
        finally:
            bar.close()
