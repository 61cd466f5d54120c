"""The files that `tso refine` reads."""

from __future__ import annotations

from pathlib import Path

from ...diagnosis.assumptions import INVERTED
from ...io.cameras import find_camera, named_masks
from ...io.masks import MaskChoice, masks_in
from ...io.shipped import DEFAULT, named_checkpoint
from ...io.views import ViewFiles
from ...scene.load import Scene, load_points_scene
from .options import RefineOptions, is_word


class RefineInputs:
    """What is refined, and with which images.

    Raises InputError for options that do not fit the masks of folders and of the camera file.

    masks : all of them. checkpoint : in the network modes the network, else None.
    network : the same in words.
    """

    def __init__(self, options: RefineOptions) -> None:
        self.options = options
        self.checkpoint: Path | None = None
        self.network: str | None = None
        if options.mode != "points":
            shipped = options.checkpoint in (None, Path(DEFAULT))
            self.network = "shipped network" if shipped else f"network {options.checkpoint}"
            self.checkpoint = named_checkpoint(options.checkpoint or Path(DEFAULT))
        masks = options.masks
        if not masks and options.camera is not None:
            masks = tuple(named_masks(options.camera, options.camera_format, options.object_id))
        self.masks = tuple(file for mask in masks for file in masks_in(mask))
        if options.fit:
            options.check_assumptions([str(mask) for mask in self.masks], len(self.masks))

    @property
    def files(self) -> list[Path]:
        """All files that are read."""
        options = self.options
        cameras = [options.camera] if options.camera else map(find_camera, self.masks)
        prior = None if is_word("prior", options.prior) else options.prior
        optional = [*([] if options.fit else cameras), options.intrinsics, self.checkpoint, prior]
        files = [Path(file) for file in optional if file is not None]
        images = [*options.ignore, *options.depth, *options.image]
        return [options.source, *self.masks, *files, *images]

    @property
    def view_files(self) -> ViewFiles:
        """The files of the views."""
        options = self.options
        return ViewFiles(
            self.masks,
            None if options.fit else options.camera,
            choice=MaskChoice(options.label, options.mask_index),
            mask_error=options.mask_error,
            camera_format=options.camera_format,
            object_id=options.object_id,
            intrinsics=options.intrinsics,
            focal=options.focal,
            fov=options.fov,
            ignore=options.ignore,
            depth=options.depth,
            depth_scale=options.depth_scale or 1.0,
            depth_kind=options.depth_kind,
            image=options.image,
        )

    def load(self) -> Scene:
        """Read everything."""
        options, files = self.options, self.view_files
        if self.checkpoint is None:
            inverted = [INVERTED.hypothesis.name] if options.invert_mask else []
            pose = (options.pose_index or 0) if options.fit else None
            assumed = [*inverted, *options.assume]
            return load_points_scene(options.source, files, assumed, pose, options.cloud_index)
        from ...scene.network import load_network_scene

        place, in_world = options.place or "silhouette", options.frame == "world"
        return load_network_scene(
            options.source, files, self.checkpoint, options.invert_mask, in_world, place
        )
