"""What `tso refine` reports of a result: four lines, every measure (-v), or a JSON document."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from ...evaluation.footprint import IOU_MEANS
from ...geometry.arrays import Pixels
from ...geometry.camera import Camera
from ...geometry.rotations import angle_between
from ...geometry.view import View
from ...io.reading import digest_of
from ...io.shipped import LEARNED, NO_PRIOR
from ...refinement.judge import CONTRADICTED_WEIGHT
from ...refinement.result import RefineResult
from ...scene.load import Scene
from ...version import __version__
from ..options import json_text, json_values
from .check import camera_document
from .inputs import RefineInputs
from .record import SCHEMA, key_of, options_of, relative
from .sentences import SMALL_DISPLACEMENT, VERDICTS, Words, two_places, why_unmoved
from .sentences_of_moves import (
    alternatives_of,
    exact_to_of,
    move_document,
    start_of,
    words_of_deviation,
    words_of_move,
    words_of_search,
)

if TYPE_CHECKING:
    from ...plots.page import PageWords
    from ...plots.recording import Iterates

CONVENTION = {
    "moved_mean": "displacement of a control point, as a share of the object's size, the longest "
    "side of the start's box",
    "chamfer_to_initial": "squared distances of control points, mean over points, both directions "
    "summed, longest side 1",
    "iou": IOU_MEANS,
    "inlier_weight": "weight of a view in the loss: 1, or less where the other views contradict it",
    "moving": "number of control points, which move by themselves: samples of a mesh's faces, or "
    "some points of a large cloud; all others follow them",
    "outliers": "points far from the rest, or that masks leave out, which stay where they are",
    "confidence": "probability that the displacement does not make the cloud worse by over "
    "5 % in Chamfer distance (a rising IoU is no proof); 1 for a start that fits and "
    "stays; null where a rule decides without it",
    "determined": "share of the motions of the points that masks and depth maps fix more firmly "
    "than a position prior; one mask alone fixes at most about two thirds; null except for the "
    "default preset in points mode",
    "moved": "whether anything moved: the shape, the cloud as one, or cameras",
    "transform": "4x4, x' = matrix x takes the cloud as it was given to where it moved as one, "
    "before its shape changed; the identity where nothing or a camera moved",
    "moved_as": "nothing, shift, pose (turn and shift), similarity (and size) or camera",
    "alternatives": "other poses that were found, best first, without those by a symmetry of the "
    "cloud; of a fitted camera their number is what --pose-index takes",
    "missed": "of the masks' contours, the share that no point of the cloud comes near: "
    "where it was given, and after it moved as one; null if nobody looked",
    "exact_to": "standard deviations of the place along the axes of the world, or of a fitted "
    "camera: degrees, shift of the middle in units of the world, logarithm of the size; null if "
    "the cloud was not placed, or does not fit there",
    "prior": "learned: the one that comes with the program",
    "moved_by_prior": "mean displacement of a control point by the learned prior, before the "
    "optimisation, also where it was left, as a share of the object's size",
    "symmetry": "a, b, c, d of the mirror plane ax + by + cz = d in the frame of the input, null "
    "for none",
    "sigma_sq": "squared 64ths of the window (encoder modes: mask and IoU are of the 64x64 crop)",
    "window": "edges of the part of the mask that is compared, px: left, top, right, bottom; "
    "cells: along its side",
}


def objective_of(result: RefineResult) -> str:
    """The objective in words."""
    settings = result.settings
    if settings.preset == "paper":
        return f"BCE + {settings.gamma:g} x Chamfer to the start"
    if settings.smooth:
        return "mask Chamfer loss; after each step, the position prior as well"
    return "mask Chamfer loss + position prior"


@dataclass(frozen=True, kw_only=True)
class RefineReport:
    """A result, what it was made from, and what is said of it.

    explicit : the options that were not left to their defaults. command : the line for a shell.
    files : what is written, by the names of the options; empty if nothing is.
    photos : of the views, for pictures. iterates : for --rerun. seconds : wall time of each phase.
    """

    result: RefineResult
    scene: Scene
    inputs: RefineInputs
    words: Words
    explicit: Mapping[str, Any]
    command: str
    files: Mapping[str, Path]
    photos: Sequence[Pixels | None]
    iterates: Iterates | None
    seconds: dict[str, float]
    warnings: list[str]

    def document(self) -> dict[str, Any]:
        """The JSON document."""
        result, fit, settings = self.result, self.result.fit, self.result.settings
        views = self._views()
        document = {
            "mode": settings.mode,
            "preset": settings.preset,
            "moving": result.control_points,
            **{name: value for name, value in vars(fit).items() if name != "outcome"},
            "learning_rate": settings.learning_rate,
            "gamma": settings.gamma,
            "sigma_sq": settings.sigma_sq,
            "prior": settings.prior,
            "symmetry": result.symmetry.coefficients,
            "symmetry_outcome": result.symmetry.outcome,
            "symmetry_reason": result.symmetry.reason,
            "device": settings.device,
            "checkpoint": self.inputs.checkpoint,
            "assume": list(self.inputs.options.assume),
            "inputs": self.inputs.files,
            "options": dict(self.explicit),
            **{
                name: self.files.get(name)
                for name in ("output", "overlay", "report", "rerun", "record")
            },
            "camera": views[0]["camera"],
            "views": views,
            "frame": self.scene.frame,
            "points": len(result.points),
            "outliers": int(result.outliers.sum()),
            "confidence": result.trust.confidence,
            "verdict": result.trust.verdict,
            "reason": self.words.reason(result),
            "warnings": self.warnings,
            "suspects": self.words.suspects(result.findings),
            "moved": result.moved,
            "determined": result.determined,
            **move_document(result.move, self.scene.fitted),
            "alternatives": alternatives_of(self.scene.fitted, result.move),
            "convention": {
                **CONVENTION,
                "loss": f"{objective_of(result)}; the mask's part is a sum over views, each times "
                "its weight",
            },
            "seconds": self.seconds,
            "version": __version__,
        }
        if result.move.kind == "camera":
            document["moved_cameras"] = [
                {name: getattr(camera, name).tolist() for name in ("K", "R", "t")}
                | {"turned_degrees": degrees, "shifted_share": shift}
                for _, camera, degrees, shift in self.corrections
            ]
        return document

    def _views(self) -> list[dict[str, Any]]:
        rows = zip(self.scene.views, self.scene.camera_sources, self.result.views, strict=True)
        return [
            {
                "mask": view.name,
                "camera": camera_document(view.camera, source),
                "iou_before": fitted.iou_before,
                "iou_after": fitted.iou_after,
                "inlier_weight": fitted.inlier_weight,
                "window": fitted.window,
                "cells": fitted.cells,
            }
            for view, source, fitted in rows
        ]

    @cached_property
    def corrections(self) -> list[tuple[View, Camera, float, float]]:
        """For each view its moved camera, the turn in degrees, and the shift by the distance."""
        start = self.result.measured[0]
        middle = (start.min(0) + start.max(0)) / 2.0
        rows = []
        for view, camera in zip(self.scene.views, self.result.cameras, strict=True):
            before, after = (c.R @ middle + c.t for c in (view.camera, camera))
            shift = float(np.linalg.norm(after - before) / np.linalg.norm(before))
            rows.append((view, camera, float(angle_between(view.camera.R, camera.R)), shift))
        return rows

    def record(self) -> str:
        """The record of the run as JSON: the document and its key."""
        folder = self.files["record"].parent
        digests = {relative(path, folder): digest_of(path) for path in self.inputs.files}
        record = {
            "schema": SCHEMA,
            "command": self.command,
            "key": key_of(self.explicit, digests.values()),
            **self.document(),
            "inputs": digests,
            "options": options_of(self.explicit, folder),
        }
        return json_text(record) + "\n"

    def page(self) -> PageWords:
        """The words of the page: the lines that are printed, the document, and the command."""
        from ...plots.page import PageWords

        lines = self.summary()
        return PageWords(
            title=self.inputs.options.source.name,
            written=lines[""],
            lines=lines,
            used=self._used(),
            verdict=VERDICTS[self.result.trust.verdict or ""],
            reason=self.words.reason(self.result),
            warnings=self.warnings,
            mirror=self._mirror(),
            command=self.command,
            document=json_values(self.document()),
        )

    def summary(self) -> dict[str, str]:
        """What was written (""), the agreement with the masks, the displacement, what was used."""
        fit, count = self.result.fit, len(self.scene.views)
        masks = f"masks, mean of {count}" if count > 1 else "mask"
        iou = f"{fit.iou_before:.3f} -> {fit.iou_after:.3f}"
        lines = {
            "": f"{self.files['output']}: {self._written()}",
            "IoU": f"{iou} with the {masks} ({self._verdict()})",
            "moved": self._moved(),
            "pose": words_of_deviation(exact_to_of(self.result.move, self.scene.fitted)),
            "used": "; ".join(self._used()),
        }
        return {name: text for name, text in lines.items() if text}

    def _used(self) -> list[str]:
        """What was used and assumed, and the time."""
        parts = [
            self.inputs.network,
            self._cameras(),
            self._prior(),
            self._symmetry(),
            self._discounted(),
            f"{self.seconds['total']:.1f} s",
        ]
        return [part for part in parts if part]

    def print_summary(self) -> None:
        for name, text in self.summary().items():
            click.echo(f"  {name:7}{text}" if name else text)

    def _written(self) -> str:
        """How many points were written, and what they follow."""
        result = self.result
        count, outliers = len(result.points), int(result.outliers.sum())
        written = count - outliers if self.inputs.options.crop else count
        if result.of_mesh:
            return (
                f"{written:,} vertices, which follow {result.control_points:,} points of the faces"
            )
        if result.control_points < count - outliers:
            return f"{written:,} points, which follow {result.control_points:,} of them"
        return f"{written:,} points"

    def _verdict(self) -> str:
        trust = self.result.trust
        if trust.verdict is None:
            return "no confidence; a rising IoU proves nothing"
        sure = "" if trust.confidence is None else f", confidence {two_places(trust.confidence)}"
        return f"{trust.verdict}{sure}"

    def _moved(self) -> str:
        as_one = words_of_move(self.result.move, start_of(self.result))
        if why := why_unmoved(self.result):
            return f"{as_one}; its shape stays: {why}" if as_one else f"nothing: {why}"
        small = f"under {100.0 * SMALL_DISPLACEMENT:g} %"
        mean, largest = (
            f"{100.0 * share:.1f} %" if share >= SMALL_DISPLACEMENT else small
            for share in (self.result.fit.moved_mean, self.result.fit.moved_max)
        )
        points = f"{mean} of the object's size on average, {largest} at most"
        return f"{as_one}, then points by {points}" if as_one else points

    def _cameras(self) -> str:
        summary = self.scene.camera_summary
        if self.result.move.kind != "camera":
            return summary
        if len(self.corrections) > 1:
            return f"{summary}, moved"
        _, _, degrees, shift = self.corrections[0]
        turned = f"turned by {degrees:.1f} degrees"
        return f"{summary}, moved: {turned}, shifted by {100.0 * shift:.1f} % of its distance"

    def _prior(self) -> str | None:
        prior, fit = self.result.settings.prior, self.result.fit
        if prior == NO_PRIOR or not fit.steps:
            return None
        name = "learned prior" if prior == LEARNED else f"prior {prior}"
        if fit.outcome != "moved":
            return f"{name} (not taken)"
        share = fit.moved_by_prior
        return f"{name} (moved {f'{100.0 * share:.1f} %' if share else 'nothing'})"

    def _symmetry(self) -> str | None:
        if not self.result.fit.steps:
            return None
        # Only the default preset in points mode assumes symmetry by default.
        as_asked = "no mirror symmetry assumed, as asked" if self.result.settings.smooth else None
        return {
            "used": "assumed mirror-symmetric, as the cloud is",
            "given": "assumed mirror-symmetric, about the given plane",
            "none_found": "no mirror symmetry assumed: the cloud has none",
            "not_asked": as_asked,
        }[self.result.symmetry.outcome]

    def _discounted(self) -> str | None:
        names = [
            view.name for view in self.result.views if view.inlier_weight < CONTRADICTED_WEIGHT
        ]
        return f"little of {', '.join(names)} (contradicted by the others)" if names else None

    def print_details(self) -> None:
        """Every measure and setting."""
        result, fit, settings = self.result, self.result.fit, self.result.settings
        best = f"best at step {fit.best_step}"
        if fit.outcome == "moved" and not fit.best_step:
            best = "best as the learned prior moved it"
        click.echo(f"  steps  {fit.steps}, {best}; ended: {fit.stop_reason}")
        loss = f"{fit.loss_before:.1f} -> {fit.loss_after:.1f}"
        click.echo(f"  loss   {loss}   ({objective_of(result)})")
        click.echo(
            f"  Chamfer to the start x1000 {fit.chamfer_to_initial * 1e3:.3f}   (squared, mean "
            "over points, both directions, longest side 1)"
        )
        click.echo(f"  IoU is {IOU_MEANS}")
        for view in result.views:
            click.echo(
                f"  view   {view.iou_before:.3f} -> {view.iou_after:.3f}   inlier weight "
                f"{view.inlier_weight:.2f}, {view.name}"
            )
        for moved_view, _, degrees, shift in (
            self.corrections if result.move.kind == "camera" else ()
        ):
            how = f"turned {degrees:.2f} degrees, shifted {100.0 * shift:.2f} % of its distance"
            click.echo(f"  camera {how}   ({moved_view.name})")
        if result.settings.move != "shape":
            click.echo(f"  as one {words_of_search(result.move)}")
        if result.determined is not None:
            click.echo(f"  fixed  {100.0 * result.determined:.0f} % of the motions of the points")
        click.echo(f"  mirror {self._mirror()}")
        click.echo(
            f"  sigma_sq {settings.sigma_sq:g} (squared 64ths of the window), learning rate "
            f"{settings.learning_rate:g}, gamma {settings.gamma:g}, preset {settings.preset}, "
            f"{settings.device}, {self.seconds['optimise']:.2f} s in the loop, "
            f"{self.seconds['total']:.2f} s in all"
        )

    def _mirror(self) -> str:
        symmetry = self.result.symmetry
        if symmetry.coefficients is None:
            return f"no plane: {symmetry.reason}"
        *normal, offset = symmetry.coefficients
        terms = [
            f"{number:+.3f} {axis}"
            for number, axis in zip(normal, "xyz", strict=True)
            if abs(number) >= 5e-4
        ]
        return f"plane {' '.join(terms).lstrip('+')} = {offset:.4g}: {symmetry.reason}"
