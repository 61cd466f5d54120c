"""The files that `tso refine` reads and writes."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from ..diagnosis.assumptions import INVERTED, assumptions_of
from ..errors import InputError
from ..geometry.arrays import Array, Pixels
from ..geometry.depth_kind import DepthKind
from ..io.cameras import CameraRecord, camera_text, find_camera, named_masks
from ..io.clouds import NEW, check_suffix, write_cloud
from ..io.masks import MaskChoice, masks_in
from ..io.output import atomic_output, check_output
from ..io.shipped import DEFAULT, named_checkpoint
from ..io.views import ViewFiles
from ..refinement import RefineResult
from ..scene.load import Placing, Scene, load_points_scene
from .options import FIT, WORDS, command_line, require_output

if TYPE_CHECKING:
    from ..plots.recording import Iterates
    from .refine_report import RefineReport


# What is written next to the result, by the name of its option.
SUFFIX_OF = {
    "overlay": ".png", "report": ".html", "rerun": ".rrd", "write_camera": ".json",
    "write_transform": ".json",
}  # fmt: skip


@dataclass
class InputOptions:
    """What is refined, and with which images, as the options say; no file is read.

    Raises InputError for options that do not go together.

    source : a cloud in points mode, else a photo.
    masks : without any, the masks that the camera file names.
    checkpoint : in the network modes the shipped network unless given.
    """

    mode: str
    preset: str
    source: Path
    masks: tuple[Path, ...]
    label: str | None
    mask_index: int | None
    mask_error: float | None
    camera: Path | None
    camera_format: str | None
    object_id: int | None
    intrinsics: Path | None
    focal: float | None
    fov: float | None
    pose_index: int | None
    assume: tuple[str, ...]
    invert_mask: bool
    ignore: tuple[Path, ...]
    depth: tuple[Path, ...]
    depth_scale: float | None
    depth_kind: DepthKind
    image: tuple[Path, ...]
    checkpoint: Path | None
    prior: Path | None
    frame: str | None
    place: Placing | None

    def __post_init__(self) -> None:
        self._check_mode()
        self._check_evidence()
        if not self.masks and (self.camera is None or self.fit):
            raise InputError(
                "no MASK was given, expected one or more, or --camera FILE whose views name their "
                "masks"
            )
        self._check_fit()
        # Which masks there are is known once folders are read.
        views = dict.fromkeys(text.partition("@")[2] for text in self.assume)
        self._check_assumptions([view for view in views if view])

    def _check_mode(self) -> None:
        if self.mode != "points":
            for name, count in (("MASK", len(self.masks)), ("--ignore", max(1, len(self.ignore)))):
                if count != 1:
                    raise InputError(
                        f"--mode {self.mode} predicts a cloud from one photo, {name} was given "
                        f"{count} times, expected once"
                    )
            places = f"found --mode {self.mode}, which places its cloud before the camera itself"
            if self.fit:
                raise InputError(f"--camera fit is for --mode points, {places}")
            for name in ("intrinsics", "focal", "fov"):
                if getattr(self, name) is not None:
                    raise InputError(f"--{name} is for --mode points, {places}")
            if self.mask_error is not None:
                raise InputError(
                    f"--mask-error is for --mode points, found --mode {self.mode}, which compares "
                    "no contours"
                )
            if self.assume:
                raise InputError(f"--assume is for --mode points, {places}")
            return
        if self.checkpoint is not None:
            raise InputError(
                f"--mode points moves a cloud, found --checkpoint {self.checkpoint}; expected "
                "--mode encoder or encoder-decoder"
            )
        if self.source.suffix.lower() == ".safetensors":
            raise InputError(
                f"{self.source}: is a checkpoint, --mode points expects a cloud; to refine with a "
                "network: tso refine --mode encoder IMAGE MASK --checkpoint FILE"
            )
        if self.frame is not None:
            raise InputError(
                "--frame is for the encoder modes; points mode keeps the frame of its cloud"
            )
        if self.place is not None:
            raise InputError(
                "--place is for the encoder modes; points mode takes its cloud to be where the "
                "camera file has it"
            )

    def _check_evidence(self) -> None:
        if self.mask_error is not None and not 0.0 < self.mask_error < math.inf:
            raise InputError(f"--mask-error {self.mask_error:g}, expected pixels, more than 0")
        for name, files in (("--depth", self.depth), ("--image", self.image)):
            if files and (self.mode, self.preset) != ("points", "best"):
                raise InputError(
                    f"{name} is for --mode points --preset best, found --mode {self.mode} "
                    f"--preset {self.preset}"
                )
        if self.depth_scale is not None and not self.depth:
            raise InputError(
                f"--depth-scale {self.depth_scale:g} says nothing without a depth map, expected "
                "--depth FILE"
            )
        if self.depth_kind != "auto" and not self.depth:
            raise InputError(
                f"--depth-kind {self.depth_kind} says nothing without a depth map, expected "
                "--depth FILE"
            )
        if self.depth and self.fit:
            raise InputError(
                "--depth needs a camera whose distance is known, found --camera fit; expected a "
                "camera file"
            )

    def _check_fit(self) -> None:
        """Options of a camera that is estimated, or of what completes one."""
        if self.pose_index is not None and not self.fit:
            raise InputError("--pose-index is for --camera fit, expected that too")
        known = [name for name in ("intrinsics", "focal", "fov") if getattr(self, name) is not None]
        if len(known) > 1:
            raise InputError(f"--{known[0]} and --{known[1]}, expected one of them")
        if self.focal is not None and not 0.0 < self.focal < math.inf:
            raise InputError(f"--focal {self.focal:g}, expected pixels, more than 0")
        if self.fov is not None and not 0.0 < self.fov < 180.0:
            raise InputError(f"--fov {self.fov:g}, expected degrees, more than 0 and under 180")

    def _check_assumptions(self, views: list[str]) -> None:
        assumptions = assumptions_of(self.assume, views)
        if not self.fit:
            return
        if len(self.masks) != 1:
            raise InputError(
                f"--camera fit finds the camera of one mask, found {len(self.masks)} masks; "
                "expected one, or a camera file"
            )
        if any(assumption.hypothesis.changes_camera for assumption in assumptions):
            raise InputError(
                "--camera fit finds the camera by itself, expected no --assume about a camera"
            )

    @property
    def fit(self) -> bool:
        """Whether the camera is estimated."""
        return self.camera == FIT


class RefineInputs(InputOptions):
    """The same with all masks, of folders and of the camera file, and the network.

    Raises InputError for options that do not go together.
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        self.network = None
        if self.mode != "points":
            shipped = self.checkpoint in (None, Path(DEFAULT))
            self.network = "shipped network" if shipped else f"network {self.checkpoint}"
            self.checkpoint = named_checkpoint(self.checkpoint or Path(DEFAULT))
        if not self.masks and self.camera is not None:
            self.masks = tuple(named_masks(self.camera, self.camera_format, self.object_id))
        self.masks = tuple(file for mask in self.masks for file in masks_in(mask))
        if self.fit:
            self._check_assumptions([str(mask) for mask in self.masks])

    @property
    def files(self) -> list[Path]:
        """All files that are read."""
        cameras = [self.camera] if self.camera else map(find_camera, self.masks)
        prior = None if str(self.prior) in WORDS["prior"] else self.prior
        known = [*([] if self.fit else cameras), self.intrinsics, self.checkpoint, prior]
        given = [path for path in known if path is not None]
        return [self.source, *self.masks, *given, *self.ignore, *self.depth, *self.image]

    @property
    def view_files(self) -> ViewFiles:
        """The files of the views."""
        return ViewFiles(
            self.masks,
            None if self.fit else self.camera,
            choice=MaskChoice(self.label, self.mask_index),
            mask_error=self.mask_error,
            camera_format=self.camera_format,
            object_id=self.object_id,
            intrinsics=self.intrinsics,
            focal=self.focal,
            fov=self.fov,
            ignore=self.ignore,
            depth=self.depth,
            depth_scale=self.depth_scale or 1.0,
            depth_kind=self.depth_kind,
            image=self.image,
        )

    def load(self) -> Scene:
        """Read everything."""
        files = self.view_files
        if self.checkpoint is None:
            inverted = [INVERTED.hypothesis.name] if self.invert_mask else []
            pose = (self.pose_index or 0) if self.fit else None
            return load_points_scene(self.source, files, [*inverted, *self.assume], pose)
        from ..scene.network import load_network_scene

        place = self.place or "silhouette"
        return load_network_scene(
            self.source, files, self.checkpoint, self.invert_mask, self.frame == "world", place
        )


@dataclass(frozen=True)
class RefineOutputs:
    """What is written."""

    output: Path
    own_suffix: str  # of the input, if it is written again with other points
    overlay: Path | None
    report: Path | None
    rerun: Path | None
    record: Path | None
    write_camera: Path | None
    write_transform: Path | None
    point_confidence: bool
    crop: bool
    overwrite: bool

    def check(self, inputs: list[Path]) -> None:
        """InputError for an output that cannot be written or would replace another file."""
        check_suffix(self.output, self.own_suffix)
        if self.point_confidence and self.output.suffix.lower() != ".ply":
            raise InputError(
                f"{self.output}: the suffix is {self.output.suffix!a}, expected .ply to hold "
                f"--point-confidence; write another file: -o {self.output.stem}.ply"
            )
        if self.crop and self.output.suffix.lower() not in NEW:
            raise InputError(
                f"{self.output}: the suffix is {self.output.suffix!a}, expected {' or '.join(NEW)} "
                f"for --crop; write another file: -o {self.output.stem}.ply"
            )
        check_output(self.output, self.overwrite)
        for name in ("overlay", "report", "rerun"):
            file = getattr(self, name)
            if file is None:
                continue
            require_output(file, SUFFIX_OF[name], self.overwrite)
            if file.resolve() in [path.resolve() for path in inputs]:
                raise InputError(f"{file}: is an input, expected another name for --{name}")
        if self.record is not None:
            check_output(self.record, self.overwrite)
            if self.record.resolve() in [path.resolve() for path in inputs]:
                raise InputError(f"{self.record}: is an input, expected another name for -o")
        others = [*inputs, self.output, *([self.overlay] if self.overlay else [])]
        for name in ("write_camera", "write_transform"):
            file = getattr(self, name)
            if file is None:
                continue
            require_output(file, SUFFIX_OF[name], self.overwrite)
            if file.resolve() in [path.resolve() for path in others]:
                raise InputError(
                    f"{file}: is another file of this command, expected another name for "
                    f"--{name.replace('_', '-')}"
                )
            others.append(file)

    def recorder(self) -> Iterates | None:
        """What keeps the steps for --rerun; fails at once where rerun is not installed."""
        if self.rerun is None:
            return None
        import rerun  # noqa: F401

        from ..plots.recording import Iterates

        return Iterates()

    def write(
        self,
        result: RefineResult,
        scene: Scene,
        inputs: RefineInputs,
        report: Callable[[], tuple[RefineReport, list[str]]],
        iterates: Iterates | None,
    ) -> None:
        """Write all files, or none: the others take their names once the cloud is written.

        ``report`` makes what page and record say, and the warnings. ``iterates`` are for --rerun.
        """
        photos: list[Pixels | None] = []
        if self.overlay or self.report or self.rerun:
            from ..scene.photos import photos_of

            photos = photos_of(scene, inputs.view_files, inputs.fit)
        with ExitStack() as stack:
            if self.overlay is not None:
                from ..plots.overlay import draw_overlay

                picture = stack.enter_context(atomic_output(self.overlay, self.overwrite))
                draw_overlay(picture, result, scene.views, photos)
            if self.report is not None:
                from ..plots.page import write_page

                page = stack.enter_context(atomic_output(self.report, self.overwrite))
                of_run, warned = report()
                write_page(page, result, scene, photos, of_run.page(warned, command_line()))
            if self.rerun is not None and iterates is not None:
                from ..plots.recording import write_recording

                recording = stack.enter_context(atomic_output(self.rerun, self.overwrite))
                lines = report()[0].summary()
                write_recording(recording, result, scene, photos, iterates, lines)
            if self.record is not None:
                of_run, warned = report()
                temporary = stack.enter_context(atomic_output(self.record, self.overwrite))
                text = of_run.record(warned, command_line())
                temporary.write_text(text, encoding="utf-8")
            if self.write_camera is not None:
                records = [
                    CameraRecord(camera, mask)
                    for camera, mask in zip(result.cameras, inputs.masks, strict=True)
                ]
                temporary = stack.enter_context(atomic_output(self.write_camera, self.overwrite))
                temporary.write_text(camera_text(self.write_camera, records), encoding="utf-8")
            if self.write_transform is not None:
                temporary = stack.enter_context(atomic_output(self.write_transform, self.overwrite))
                temporary.write_text(transform_text(result.move.matrix), encoding="utf-8")
            self.check([])  # before the first of them takes its name
            write_cloud(
                self.output,
                scene.to_output(result.points),
                like=scene.file,
                overwrite=self.overwrite,
                matrix=result.move.matrix,
                confidence=result.point_confidence,
                kept=~result.outliers if self.crop and result.outliers.any() else None,
            )


def transform_text(matrix: Array) -> str:
    """The 4x4 matrix that a cloud moved by as one, as JSON."""
    document = {
        "matrix": matrix.tolist(),
        "convention": "x' = matrix x, for columns x = (x, y, z, 1) in the units of the cloud",
    }
    return json.dumps(document, indent=2) + "\n"
