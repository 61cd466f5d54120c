"""One run of `tso refine`: files in, result, files and words out."""

from __future__ import annotations

import sys
import time
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ...diagnosis.assumptions import left_handed
from ...diagnosis.examine import NoOverlapError
from ...errors import GateError, InputError
from ...geometry.arrays import Array
from ...io.reading import require_memory
from ...refinement import RefineResult, refine
from ..options import ProgressBar, echo_json, log, naming
from .check import check_scene
from .inputs import RefineInputs
from .options import RefineOptions
from .outputs import WITH_PHOTOS, RefineOutputs
from .report import RefineReport
from .sentences import Words

# Memory of one control point.
BYTES_OF_A_CONTROL_POINT = 1100
EXIT_UNCHANGED = 4
"""The exit code with --strict where the cloud is written as it was."""
INTERRUPTED = 130
"""The exit code after Ctrl-C."""


class RefineRun:
    """What the options ask for, read and checked.

    explicit : the options that have another value than their default. messages : the list to which
    warnings are added as they come. shell_command : the line that repeats this run.
    """

    def __init__(
        self,
        options: RefineOptions,
        explicit: Mapping[str, Any],
        messages: list[str],
        shell_command: str,
        config: Path | None = None,
    ) -> None:
        self._started = time.perf_counter()
        self._options, self._explicit = options, explicit
        self._messages, self._shell_command = messages, shell_command
        self._inputs, self._outputs = RefineInputs(options), RefineOutputs(options)
        self._iterates = None
        if not options.check:
            self._outputs.check(self._inputs.files, config)
            self._iterates = self._outputs.recorder()
        self._scene = self._inputs.load()
        if options.verbose or (options.check and not options.quiet):
            if self._inputs.checkpoint is not None:
                log(f"tso: checkpoint: {self._inputs.checkpoint}")
            log(f"tso: camera: {', '.join(dict.fromkeys(self._scene.camera_sources))}")
        by_scene = options.sigma_sq is None and options.preset == "paper"
        self._config = options.config(**{"sigma_sq": self._scene.sigma_sq} if by_scene else {})
        self._settings = self._config.settings()
        self._words = Words(
            [view.name for view in self._scene.views],
            options.invert_mask,
            [str(file) for file in options.depth],
            options.depth_scale or 1.0,
            may_turn=self._settings.move in ("auto", "shape"),
            accepting=self._settings.accept_doubtful,
        )

    def check(self) -> int:
        """Examine the input alone; the exit code."""
        options = self._options
        reason = check_scene(
            self._scene, self._settings, self._words, self._messages, options.as_json, options.quiet
        )
        if reason and options.strict:
            raise GateError(f"{options.source}: the result would be doubtful: {reason}")
        return 0

    def refine(self) -> int:
        """Refine, write the files and print the result; the exit code."""
        options, report = self._options, self.work()
        result = report.result
        if options.as_json:
            echo_json(report.document())
        if not report.files:
            raise GateError(
                f"{options.source}: the result is {result.trust.verdict or 'without confidence'}: "
                f"{self._words.reason(result)}; with --strict nothing is written"
            )
        if not options.as_json and not options.quiet:
            report.print_summary()
            self._outputs.print_names()
            if options.verbose:
                report.print_details()
        if result.fit.stop_reason == "interrupted":
            return INTERRUPTED
        return EXIT_UNCHANGED if options.strict and not result.moved else 0

    def work(self) -> RefineReport:
        """Refine and write the files; with --strict, a doubtful result has none."""
        options, scene, started = self._options, self._scene, self._started
        if options.write_camera and left_handed(scene.given.assumptions):
            raise InputError(
                f"--write-camera {options.write_camera}: the cloud has left-handed axes, which no "
                f"camera has; found --assume {' '.join(options.assume)}, expected a cloud with "
                "right-handed axes"
            )
        seconds = {"read": time.perf_counter() - started}
        result = self._result()
        until_refined = time.perf_counter() - started
        refused = options.strict and result.trust.verdict in ("doubtful", None)
        for sentence in self._words.warnings(result, refused):
            warnings.warn(sentence, stacklevel=1)
        files = {} if refused else self._outputs.files
        photos = []
        if not WITH_PHOTOS.isdisjoint(files):
            from ...scene.photos import photos_of

            photos = photos_of(scene, self._inputs.view_files, options.fit)
        seconds |= {**result.cost.seconds, "total": until_refined}
        report = RefineReport(
            result=result,
            scene=scene,
            inputs=self._inputs,
            words=self._words,
            explicit=self._explicit,
            command=self._shell_command,
            files=files,
            photos=photos,
            iterates=self._iterates,
            seconds=seconds,
            warnings=self._messages,
        )
        if not refused:
            self._outputs.write(report)
        del seconds["total"]
        total = time.perf_counter() - started
        seconds |= {"write": total - until_refined, "total": total}
        return report

    def _result(self) -> RefineResult:
        """The result, with a progress bar on a terminal."""
        scene, options, iterates = self._scene, self._options, self._iterates
        points_mode = options.mode == "points"
        if points_mode and self._settings.points is None:
            require_memory(options.source, BYTES_OF_A_CONTROL_POINT * len(scene.points))
        bar, has_bar = ProgressBar("tso: refining"), sys.stderr.isatty() and not options.quiet

        def on_progress(step: int, total: int, loss: float, points: Array) -> None:
            if has_bar:
                bar(step, total, f"steps, loss {loss:.6g}" if options.verbose else "steps")
            if iterates is not None:
                iterates.add(step, loss, points)

        try:
            with naming(options.source):
                return refine(
                    scene.given.cloud if points_mode else None,
                    scene.given.read,
                    config=self._config,
                    assume=scene.given.assumptions,
                    network=scene.network,
                    image=scene.image,
                    known=scene.given.known,
                    progress=on_progress if has_bar or iterates is not None else None,
                )
        except NoOverlapError as error:
            raise self._words.no_overlap(error) from None
        finally:
            bar.close()
