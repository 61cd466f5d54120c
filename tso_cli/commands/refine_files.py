"""The files that `tso refine` reads."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from ..diagnosis.assumptions import INVERTED, assumptions_of
from ..errors import InputError
from ..geometry.depth_kind import DepthKind
from ..io.cameras import find_camera, named_masks
from ..io.masks import MaskChoice, masks_in
from ..io.shipped import DEFAULT, named_checkpoint
from ..io.views import ViewFiles
from ..scene.load import Placing, Scene, load_points_scene
from .options import FIT, WORDS


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
