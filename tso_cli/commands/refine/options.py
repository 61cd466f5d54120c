"""The options of `tso refine`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Literal

from ...errors import InputError
from ...geometry.depth_kind import DepthKind
from ...io.shipped import DEFAULT
from ...optimisation.config import BEST_POINTS, NETWORK, RefineConfig
from ...option import declared, opt
from .. import options

FIT = Path("fit")
"""What `--camera` takes instead of a file, to estimate the camera."""
POINTS = {"mode": ("points",)}
NETWORK_MODES = {"mode": ("encoder", "encoder-decoder", "latent")}
EVIDENCE = "Further input, one image for each mask or none"
PLACES_ITSELF = "the other modes place their cloud before the camera themselves"


def _hypotheses() -> dict[str, str]:
    """The table that `--assume list` prints."""
    from ...diagnosis.hypotheses import HYPOTHESES, of_width

    example = of_width(518)
    return {hypothesis.name: hypothesis.says for hypothesis in (*HYPOTHESES.values(), example)}


@dataclass(frozen=True, kw_only=True)
class RefineOptions(RefineConfig):
    """What `tso refine` may be given; InputError for options that do not go together.

    No file is read: which masks a folder or a camera file holds is found by `RefineInputs`.

    source : A cloud; in the network modes a photo.
    masks : Masks, or folders of masks.
    checkpoint : File of tso train, or `default`, the shipped network.
    frame : Axes of the output of a view-aligned network: the camera's, or the world's.
    place : How the cloud of a view-aligned network is placed: its silhouette, or its box, fits the
        mask; or it stands at t of the camera file, as an object of longest side 1 around the
        origin.
    refine_camera : The same as --move camera.
    cloud_index : Place of the cloud in an array [B, N, 3] of several.
    camera : Camera file or folder of any program, or `fit` to estimate it.
    intrinsics : Camera file whose K is used: with a --camera that holds poses alone, or with
        --camera fit.
    focal : The focal length in pixels of the mask: with --camera fit, or with a --camera that holds
        poses alone.
    fov : The same as horizontal field of view, degrees.
    pose_index : With --camera fit: which of the poses that were found is used, as --json lists
        them; 0 is the best.
    assume : How the input is meant, if not as tso expects, e.g. camera-to-world or cloud-z-up;
        NAME@MASK for one mask of several. Warnings name the likely one; `--assume list` lists all.
    invert_mask : The object is dark in the mask.
    mask_error : How exactly the masks show where the outline is, a standard deviation in pixels.
    ignore : Image whose bright pixels are unknown: the loss leaves them out.
    depth : Depth map along the camera's z axis, 16-bit PNG, .npy or .npz; 0 and NaN are unknown.
    depth_scale : Size of one step of the depth map in units of the camera; 0.001 for millimetres
        and metres.
    depth_kind : What the depth map holds: depth along z; inverse (disparity) or affine depth, up to
        scale and shift; or distance along the ray. `auto`: along z, and ignored if the cloud shows
        another kind.
    image : Photo of the mask. With --camera fit it decides between poses of a cloud with colours.
        Otherwise --report, --overlay and --rerun only show it.
    output : Refined cloud.
    crop : Write the object alone, without points far from the rest or that most masks leave out.
    strict : Write nothing if the result is doubtful or has no confidence: exit code 3. Exit code 4
        if the cloud is left.
    overlay : Picture of mask, silhouette and cloud before and after, .png.
    report : Interactive page of the result, .html.
    rerun : Recording of the optimisation for the viewer rerun, .rrd.
    write_camera : Write the fitted or moved cameras, .json.
    write_transform : Write the 4x4 matrix that the cloud moved by as one, .json.
    record : Write NAME.record.json next to the result: inputs, settings, findings.
    check : Only print camera, scale, the overlap with the mask, and what may be wrong.
    verbose : Also print all measures and settings, for each view.
    """

    source: Path = opt(options.REQUIRED, role="argument", names=("cloud",))
    masks: tuple[Path, ...] = opt((), role="argument", names=("mask",), metavar="[MASK]...")
    checkpoint: Path | None = opt(
        None,
        "default",
        heading=NETWORK,
        words=(DEFAULT,),
        only=NETWORK_MODES,
        why="a cloud needs no network",
        role="input",
    )
    frame: Literal["view", "world"] | None = opt(
        None, "view", only=NETWORK_MODES, why="points mode keeps the frame of its cloud"
    )
    place: Literal["silhouette", "box", "camera"] | None = opt(
        None,
        "silhouette",
        only=NETWORK_MODES,
        why="points mode takes its cloud to be where the camera file has it",
    )
    refine_camera: bool = opt(
        False,
        heading="What moves as one first (points mode)",
        only={**POINTS, "move": (None, "camera")},
    )
    cloud_index: int | None = opt(None, metavar="N", least=0, only=POINTS)
    camera: Path | None = opt(
        None,
        "a file next to the mask, else a canonical camera",
        heading="Camera",
        brief=True,
        words=(str(FIT),),
        role="input",
    )
    camera_format: str | None = options.camera_format()
    intrinsics: Path | None = opt(
        None, only=POINTS, why=PLACES_ITSELF, excludes=("focal", "fov"), role="input"
    )
    focal: float | None = opt(
        None,
        "with fit that of the EXIF data of the photo, else unknown",
        above=0.0,
        below=options.INFINITY,
        only=POINTS,
        why=PLACES_ITSELF,
        excludes=("fov",),
    )
    fov: float | None = opt(None, above=0.0, below=180.0, only=POINTS, why=PLACES_ITSELF)
    pose_index: int | None = opt(None, "0", least=0, only={"camera": (FIT,)})
    object_id: int | None = options.object_id()
    assume: tuple[str, ...] = opt(
        (), metavar="NAME", table=_hypotheses, only=POINTS, why=PLACES_ITSELF
    )
    invert_mask: bool = opt(False, heading=EVIDENCE)
    label: str | None = options.label()
    mask_index: int | None = options.mask_index()
    mask_error: float | None = opt(
        None,
        "by their softness and size, at least 0.5",
        metavar="PX",
        above=0.0,
        below=options.INFINITY,
        only=POINTS,
        why="the other modes compare no contours",
    )
    ignore: tuple[Path, ...] = opt((), role="input")
    depth: tuple[Path, ...] = opt((), only=BEST_POINTS, role="input")
    depth_scale: float | None = opt(None, "1", needs=("depth",))
    depth_kind: DepthKind = opt("auto", needs=("depth",))
    image: tuple[Path, ...] = opt((), only=BEST_POINTS, role="input")
    output: Path | None = opt(
        None,
        "SOURCESTEM.refined.ply, or .glb, .gltf or .obj as the input, in the current folder",
        heading="Output",
        brief=True,
        names=("-o", "output"),
        role="output",
    )
    overwrite: bool = options.overwrite()
    crop: bool = opt(False)
    strict: bool = opt(False, brief=True, role="output")
    overlay: Path | None = opt(None, brief=True, role="output")
    report: Path | None = opt(None, brief=True, role="output")
    rerun: Path | None = opt(None, role="output")
    write_camera: Path | None = opt(None, only=POINTS, why=PLACES_ITSELF, role="output")
    write_transform: Path | None = opt(None, only=POINTS, why=PLACES_ITSELF, role="output")
    record: bool = opt(False, role="run")
    check: bool = opt(False, heading="Running", brief=True, role="run")
    quiet: bool = options.quiet("Print nothing but errors and the document of --json.")
    verbose: bool = opt(False, names=("-v", "verbose"), excludes=("quiet",), role="run")
    as_json: bool = options.as_json()

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.mode != "points":
            self._check_network_mode()
        elif self.source.suffix.lower() == ".safetensors":
            raise InputError(
                f"{self.source}: is a checkpoint, --mode points expects a cloud; to refine with a "
                "network: tso refine --mode encoder IMAGE MASK --checkpoint FILE"
            )
        if not self.masks and (self.camera is None or self.fit):
            raise InputError(
                "no MASK was given, expected one or more, or --camera FILE whose views name their "
                "masks"
            )
        if self.depth and self.fit:
            self._check_pose_with_depth()
        # Masks of folders are not read yet: any @MASK is accepted here, and checked later.
        views = dict.fromkeys(text.partition("@")[2] for text in self.assume)
        self.check_assumptions([view for view in views if view], len(self.masks))
        move = self.config().settings().move
        if self.write_transform and move in ("shape", "camera"):
            raise InputError(
                f"--write-transform is for a cloud that moves as one, found --move {move}, which "
                "leaves it where it is"
            )

    def _check_pose_with_depth(self) -> None:
        """The cloud moves before a camera at the origin."""
        if self.move not in (None, "auto", "pose", "similarity"):
            raise InputError(
                "--camera fit with --depth moves the cloud to where the depth map has it, found "
                f"--move {self.move}; expected pose (the cloud has the right size) or similarity"
            )
        if self.pose_index is not None:
            raise InputError(
                "--pose-index is for --camera fit without --depth; with --depth, --json lists the "
                "other places as alternatives"
            )

    def _check_network_mode(self) -> None:
        for name, count in (("MASK", len(self.masks)), ("--ignore", max(1, len(self.ignore)))):
            if count != 1:
                raise InputError(
                    f"--mode {self.mode} predicts a cloud from one photo, {name} was given {count} "
                    "times, expected once"
                )
        if self.fit:
            raise InputError(
                f"--camera fit is for --mode points, found --mode {self.mode}; {PLACES_ITSELF}"
            )

    def check_assumptions(self, views: list[str], masks: int) -> None:
        """InputError for --assume with names other than ``views``, or against --camera fit."""
        if self.fit and masks != 1:
            raise InputError(
                f"--camera fit finds the camera of one mask, found {masks} masks; expected one, or "
                "a camera file"
            )
        if not self.assume:
            return
        from ...diagnosis.assumptions import assumptions_of

        assumptions = assumptions_of(self.assume, views)
        if self.fit and any(assumption.hypothesis.changes_camera for assumption in assumptions):
            raise InputError(
                "--camera fit finds the camera by itself, expected no --assume about a camera"
            )

    @property
    def fit(self) -> bool:
        """Whether the camera is estimated."""
        return self.camera == FIT

    def config(self, **more: Any) -> RefineConfig:
        """The settings of the method, with ``more``."""
        settings = {field.name: getattr(self, field.name) for field in fields(RefineConfig)}
        if self.refine_camera:
            settings["move"] = "camera"
        if self.fit and self.depth and self.move in (None, "auto"):
            settings["move"] = "similarity"
        return RefineConfig(**settings | more)


def is_word(name: str, value: Any) -> bool:
    """Whether ``value`` is a word that the option takes in place of a file."""
    return str(value) in declared(RefineOptions)[name].option.words


def without_roles(values: Mapping[str, Any], *roles: str) -> dict[str, Any]:
    """The ``values`` of the options whose role (`Option.role`) is another."""
    table = declared(RefineOptions)
    return {name: v for name, v in values.items() if table[name].option.role not in roles}
