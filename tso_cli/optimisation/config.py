"""What a caller may choose, `RefineConfig`, and the same with every value, `Settings`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from ..errors import InputError
from ..io.shipped import LEARNED, NO_PRIOR
from ..option import AUTO, check, opt
from ..pose import Asked, Keep
from .presets import DEFAULTS, FEWEST_CONTROL_POINTS, MOST_POINTS, Mode, Preset

MOVES = "What moves as one first (points mode)"
NETWORK = "Network modes"
BEST_POINTS = {"mode": ("points",), "preset": ("best",)}


@dataclass(frozen=True, kw_only=True)
class RefineConfig:
    """Settings of one refinement; InputError for a value out of range, or two that do not fit.

    None stands for the value of preset and mode, in the table `DEFAULTS` of
    ``optimisation/presets.py``.

    mode : What is optimised: the points, the network's encoder, all of its weights, or its latent
        code.
    preset : Loss and defaults: the most accurate on validation shapes, or the paper's.
    prior : The network that first moves the cloud to a likely shape: the shipped one, none, or a
        file of tso train-prior.
    points : How many control points move by themselves, 16 to 16,384 (of a mesh at most 4,096); all
        other points follow.
    symmetry : Mirror plane of the object: detected, none, normal to an axis of the cloud through
        its middle, or ax+by+cz=d.
    steps : Optimiser steps; 0 leaves the shape.
    learning_rate : Of Adam, for a cloud of longest side 1.
    gamma : Weight of the Chamfer distance to the start, for a cloud of longest side 1, with
        `preset` paper.
    sigma_sq : Variance of the projector's Gaussian, in squared 64ths of the object's window, with
        `preset` paper.
    accept_doubtful : Move the points even where a doubtful cloud would be left.
    point_confidence : Write how far the masks determine each point, 0 to 1, as `confidence` of the
        .ply.
    move : What moves as one first: auto, shape (nothing), pose, similarity or camera.
    keep : What stays where one camera cannot tell size from distance. `auto`: the size for a pose,
        the distance for a similarity and for `move` auto.
    only : Only move as one, and leave the shape as it is.
    device : cpu, cuda, cuda:1, mps or auto. GPU support (Triton kernels) is experimental. Points
        mode has no network, and runs on the CPU.
    """

    mode: Mode = opt("points", heading="Method", brief=True)
    preset: Preset = opt("best", brief=True)
    prior: str | Path | None = opt(
        None,
        "learned; paper and network modes: none",
        metavar="learned|none|FILE",
        words=(LEARNED, NO_PRIOR),
        neutral=(NO_PRIOR, Path(NO_PRIOR)),
        only=BEST_POINTS,
    )
    points: int | None = opt(
        None,
        "auto: 1024; paper: all",
        metavar="auto|N",
        words=(AUTO,),
        least=FEWEST_CONTROL_POINTS,
        most=MOST_POINTS,
        only=BEST_POINTS,
    )
    symmetry: str | None = opt(
        None, "auto; paper and network modes: none", metavar="auto|none|x|y|z|a,b,c,d"
    )
    steps: int | None = opt(None, "20; encoder modes 12, latent 30; paper 50", least=0)
    learning_rate: float | None = opt(
        None,
        "4e-3 points, 3e-5 encoder, 6e-5 encoder-decoder, 1e-3 latent; paper 5e-4, 1e-6, 5e-6, "
        "1e-3",
        above=0.0,
        most=1e6,
    )
    gamma: float | None = opt(
        None, "1e6, encoder 0", least=0.0, most=1e15, only={"preset": ("paper",)}
    )
    sigma_sq: float | None = opt(None, "0.4", above=0.0, most=1e9, only={"preset": ("paper",)})
    accept_doubtful: bool = opt(False)
    point_confidence: bool = opt(False, only=BEST_POINTS)
    move: Asked | None = opt(
        None,
        "auto; paper and network modes: shape",
        heading=MOVES,
        brief=True,
        metavar="WHAT",
        neutral=("shape",),
        only={"mode": ("points",)},
        why="the other modes place their cloud before the camera themselves",
    )
    keep: Keep = opt("auto", only={"move": (None, "auto", "pose", "similarity")})
    only: bool = opt(
        False, only={"move": (None, "auto", "pose", "similarity", "camera")}, excludes=("steps",)
    )
    device: str = opt("cpu", heading=NETWORK, metavar="DEVICE")

    def __post_init__(self) -> None:
        check(self)
        if self.only and self.settings().move == "shape":
            raise InputError("`only` says nothing where nothing moves, expected `move` too")
        if self.mode == "points" and self.device not in ("cpu", "auto"):
            raise InputError(
                f"`device` is {self.device!r}, expected cpu or auto: mode points has no network to "
                "put there"
            )
        if self.symmetry is not None:
            from .symmetry import parse_symmetry

            parse_symmetry(self.symmetry)

    def settings(self) -> Settings:
        """The same with the values of preset and mode in place of None."""
        options = {name: value for name, value in vars(self).items() if value is not None}
        names = Settings.__dataclass_fields__
        values = vars(DEFAULTS[self.preset, self.mode]) | options
        if self.only:
            values["steps"] = 0
        values["prior"] = str(values["prior"])
        return Settings(**{name: values[name] for name in names})


@dataclass(frozen=True, kw_only=True)
class Settings(RefineConfig):
    """A `RefineConfig` with every value; ``points`` may be None, which stands for all points."""

    steps: int
    learning_rate: float
    gamma: float
    symmetry: str
    sigma_sq: float
    move: Asked
    prior: str

    def __post_init__(self) -> None:
        """The values were checked before the defaults were put in."""

    @property
    def smooth(self) -> bool:
        """Whether the default preset moves points."""
        return self.preset == "best" and self.mode == "points"


def config_of(config: RefineConfig | Mapping[str, Any] | None) -> RefineConfig:
    """The settings of a caller; None stands for the defaults. InputError for another kind."""
    if isinstance(config, Mapping):
        names = [field.name for field in fields(RefineConfig)]
        if unknown := [key for key in config if key not in names]:
            raise InputError(f"config has {unknown[0]!r:.40}, expected {', '.join(names)}")
        return RefineConfig(**config)
    if not isinstance(config, RefineConfig | None):
        raise InputError(f"config is of type {type(config).__name__}, expected a RefineConfig")
    return config or RefineConfig()
