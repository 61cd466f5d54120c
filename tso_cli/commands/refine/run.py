"""One run of `tso refine`: files in, result, files and words out."""

from __future__ import annotations

import sys
import time
import warnings
from collections.abc import Mapping
from functools import partial
from typing import Any

from ...diagnosis.assumptions import left_handed
from ...diagnosis.examine import NoOverlapError
from ...errors import GateError, InputError
from ...geometry.arrays import Array
from ...io.reading import require_memory
from ...refinement import RefineResult, refine
from .. import options
from .check import check_scene
from .inputs import RefineInputs
from .options import RefineOptions
from .outputs import Finished, RefineOutputs
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
            self._log_sources()
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
        reason = check_scene(
            self._scene,
            self._settings,
            self._words,
            self._options.as_json,
            self._options.quiet,
            self._warned,
        )
        if reason and self._options.strict:
            raise GateError(f"{self._options.source}: the result would be doubtful: {reason}")
        return 0

    def refine(self) -> int:
        """Refine, write the files and print the result; the exit code."""
        report, refused = self.work()
        self._print(report, refused)
        if report.result.fit.stop_reason == "interrupted":
            return INTERRUPTED
        return LEFT if self._options.strict and not report.result.moved else 0

    def work(self) -> tuple[RefineReport, bool]:
        """Refine and write the files: the report, and whether --strict left them unwritten."""
        self._require_writable_cameras()
        read = time.perf_counter() - self._started
        result = self._refined()
        writing = time.perf_counter()
        refused = self._options.strict and result.trust.verdict in ("doubtful", None)
        if not refused:
            seconds = {"read": read, **result.cost.seconds}
            report = partial(self._words_so_far, result, seconds)
            run = Finished(result, self._scene, self._inputs, report, self._line, self._iterates)
            self._outputs.write(run)
        finished = time.perf_counter()
        for text in self._words.warnings(result, refused):
            warnings.warn(text, stacklevel=1)
        times = {"write": finished - writing, "total": finished - self._started}
        return self._report(result, {"read": read, **result.cost.seconds, **times}), refused

    def _log_sources(self) -> None:
        if self._inputs.checkpoint is not None:
            options.log(f"tso: checkpoint: {self._inputs.checkpoint}")
        options.log(f"tso: camera: {', '.join(dict.fromkeys(self._scene.camera_sources))}")

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
        bar_shown = sys.stderr.isatty() and not self._options.quiet

        def on_progress(step: int, total: int, loss: float, points: Array) -> None:
            if bar_shown:
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
                    progress=on_progress if bar_shown or iterates is not None else None,
                )
        except NoOverlapError as error:
            raise self._words.no_overlap(error) from None
        finally:
            bar.close()

    def _report(self, result: RefineResult, seconds: dict[str, float]) -> RefineReport:
        of_run = self._scene, self._inputs, self._outputs, self._words
        return RefineReport(result, *of_run, seconds, self._given)

    def _words_so_far(
        self, result: RefineResult, seconds: dict[str, float]
    ) -> tuple[RefineReport, list[str]]:
        """What a page or a record says: of the seconds, those until now; and the warnings."""
        so_far = {**seconds, "total": time.perf_counter() - self._started}
        return self._report(result, so_far), [*self._warned, *self._words.warnings(result)]

    def _print(self, report: RefineReport, refused: bool) -> None:
        result = report.result
        if self._options.as_json:
            options.echo_json(report.document(self._warned, written=not refused))
        if refused:
            verdict = result.trust.verdict or "without confidence"
            raise GateError(
                f"{self._options.source}: the result is {verdict}: {self._words.reason(result)}; "
                "with --strict nothing is written"
            )
        if not self._options.as_json and not self._options.quiet:
            report.print_summary()
            if self._options.verbose:
                report.print_details()
