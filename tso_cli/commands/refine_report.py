"""What `tso refine` reports of a result: four lines, every measure and setting (-v), or a JSON document."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import click
import numpy as np

from ..diagnosis.confidence import shown
from ..evaluation.footprint import IOU_MEANS
from ..geometry.camera import Camera
from ..geometry.rotations import angle_between
from ..geometry.view import View
from ..optimisation.camera_correction import MISFIT_LEFT
from ..refinement.result import (
    DOUBTFUL_INLIER_WEIGHT,
    SMALL_DISPLACEMENT,
    RefineResult,
    refused,
    why_unmoved,
)
from ..scene.load import Scene
from ..version import __version__
from .refine_check import camera_document, verdict_document
from .refine_files import RefineInputs, RefineOutputs

# Entries of the document that are attributes of the result.
FROM_RESULT = (
    *("mode", "preset", "moving", "steps", "best_step", "stop_reason"),
    *("loss_before", "loss_after", "losses"),
    *(
        "iou_before",
        "iou_after",
        "moved_mean",
        "moved_max",
        "chamfer_to_initial",
        "learning_rate",
        "gamma",
        "sigma_sq",
    ),
    *("symmetry", "symmetry_outcome", "symmetry_reason", "device"),
)


@dataclass(frozen=True)
class RefineReport:
    """A result and what it was made from.

    refine_camera : the cameras were corrected, or left because no correction was better. seconds : wall time of each phase.
    """

    result: RefineResult
    scene: Scene
    inputs: RefineInputs
    outputs: RefineOutputs
    refine_camera: bool
    budget: str | float
    seconds: dict[str, float]

    def document(self, warnings: list[str], written: bool = True) -> dict[str, Any]:
        """The JSON document; ``written`` : whether the outputs are."""
        result, scene = self.result, self.scene
        views = []
        for i, view in enumerate(scene.views):
            before, after = result.view_ious[i]
            box, cells = result.view_windows[i]
            camera = {
                "mask": view.name,
                "camera": camera_document(view.camera, scene.camera_sources[i]),
            }
            weights = {"trust": result.inlier_weights[i], "weight": result.view_weights[i]}
            views.append(
                camera
                | {"iou_before": before, "iou_after": after}
                | weights
                | {"window": box, "cells": cells}
            )
        document = {
            **{name: getattr(result, name) for name in FROM_RESULT},
            "checkpoint": self.inputs.checkpoint,
            "assume": list(self.inputs.assume),
            "output": self.outputs.output if written else None,
            "overlay": self.outputs.overlay if written else None,
            "camera": views[0]["camera"],
            "views": views,
            "frame": scene.frame,
            "points": len(result.points),
            "outliers": int(result.outliers.sum()),
            **verdict_document(
                result.confidence, result.verdict, result.reason, warnings, result.suspects
            ),
            "step_taken": result.step_taken,
            "budget": {
                "given": self.budget,
                "decisions": [decision.document() for decision in result.budget],
            },
            "convention": {
                "moved": "way of a point from its start, as a share of the object's size, the longest side of the start's box",
                "chamfer_to_initial": "squared distances, mean over points, both directions summed, longest side 1",
                "iou": IOU_MEANS,
                "trust": "in a view: 1, or less where the other views contradict it",
                "moving": "points that move by themselves, which moved and chamfer_to_initial are of: samples of a mesh's "
                "faces, or some of a large cloud; all others follow them",
                "outliers": "points far from the rest, which stay where they are",
                "confidence": "that the whole step does not make the cloud worse by over 5 % in Chamfer distance (a rising IoU "
                "is no proof); 1 where nothing moved, else null but for the default preset of points mode",
                "step_taken": "share of the step that was taken: under 1 where it is doubtful, 0 where nothing moved",
                "saving": "share that was spared: of the masks' pixels, the finest grid's cells, the points, the steps of "
                "--budget full, the work that a mirror plane takes",
                "weight": "of a view in the loss: its trust, divided among the views that show the same",
                "loss": result.objective
                + "; the mask's part is a sum over views, each times its weight",
                "symmetry": "a, b, c, d of the mirror plane ax + by + cz = d in the frame of the input, null for none",
                "sigma_sq": "squared 64ths of the window (encoder modes: mask and IoU are those of the 64x64 crop)",
                "window": "edges of the part of the mask that is looked at, px: left, top, right, bottom; "
                "cells: along its side",
            },
            "seconds": self.seconds,
            "version": __version__,
        }
        if self.refine_camera:
            document["refined_cameras"] = [
                {name: getattr(camera, name).tolist() for name in ("K", "R", "t")}
                | {"turned_degrees": degrees, "shifted_share": shift}
                for _, camera, degrees, shift in self.corrections
            ]
        return document

    @cached_property
    def corrections(self) -> list[tuple[View, Camera, float, float]]:
        """For each view: the refined camera, its turn in degrees, and the cloud's shift relative to its distance."""
        start = self.result.judged[0]
        middle = (start.min(0) + start.max(0)) / 2.0
        rows = []
        for view, camera in zip(self.scene.views, self.result.cameras, strict=True):
            before, after = (c.R @ middle + c.t for c in (view.camera, camera))
            shift = float(np.linalg.norm(after - before) / np.linalg.norm(before))
            rows.append((view, camera, float(angle_between(view.camera.R, camera.R)), shift))
        return rows

    def print_summary(self) -> None:
        """What was written, the agreement with the masks, how far the points moved, and what was assumed."""
        result, count = self.result, len(self.scene.views)
        follow = (
            f"vertices, which follow {result.moving:,} points of the faces"
            if result.surface
            else "points"
        )
        if not result.surface and result.moving < len(result.points) - int(result.outliers.sum()):
            follow = f"points, which follow {result.moving:,} of them"
        masks = f"masks, mean of {count}" if count > 1 else "mask"
        # Of a start that is left as it is, the confidence says nothing of the mistake that is suspected.
        told = result.verdict != "doubtful" or result.best_step or refused(result)
        sure = (
            f", confidence {shown(result.confidence)}"
            if told and result.confidence is not None
            else ""
        )
        verdict = f"{result.verdict}{sure}" if result.verdict else "not judged; IoU proves nothing"
        used = [
            self.inputs.network,
            self._cameras(),
            self._symmetry(),
            self._discounted(),
            f"{self.seconds['total']:.1f} s",
        ]
        click.echo(f"{self.outputs.output}: {len(result.points):,} {follow}")
        click.echo(
            f"  IoU    {result.iou_before:.3f} -> {result.iou_after:.3f} with the {masks} ({verdict})"
        )
        click.echo(f"  moved  {self._moved()}")
        click.echo(f"  used   {'; '.join(part for part in used if part)}")
        for path, content in (
            (self.outputs.overlay, "picture"),
            (self.outputs.write_camera, "camera"),
        ):
            if path is not None:
                click.echo(f"{path}: {content}")

    def _moved(self) -> str:
        if why := why_unmoved(self.result):
            return f"nothing: {why}"
        mean, largest = (
            f"{100.0 * share:.1f} %"
            if share >= SMALL_DISPLACEMENT
            else f"under {100.0 * SMALL_DISPLACEMENT:g} %"
            for share in (self.result.moved_mean, self.result.moved_max)
        )
        return f"{mean} of the object's size on average, {largest} at most"

    def _cameras(self) -> str:
        summary = self.scene.camera_summary
        if not self.refine_camera or not self.result.steps:
            return summary
        corrected = [row for row in self.corrections if row[0].camera is not row[1]]
        if not corrected:
            return f"{summary}, kept: no small correction explains the misfit"
        if len(self.corrections) > 1:
            return f"{summary}, {len(corrected)} of {len(self.corrections)} corrected"
        _, _, degrees, shift = corrected[0]
        return f"{summary}, corrected: turned by {degrees:.1f} degrees, shifted by {100.0 * shift:.1f} % of its distance"

    def _symmetry(self) -> str | None:
        if not self.result.steps:
            return None
        pictures = "mask contradicts" if len(self.result.cameras) == 1 else "masks contradict"
        return {
            "used": "assumed mirror-symmetric, as the cloud is",
            "given": "assumed mirror-symmetric, about the given plane",
            "none_found": "no mirror symmetry assumed: the cloud has none",
            "contradicted": f"no mirror symmetry assumed: the {pictures} it",
            # Only points mode with the preset best assumes symmetry by default.
            "unchecked": "no mirror symmetry assumed: the budget left no time to check it",
            "not_asked": "no mirror symmetry assumed, as asked" if self.result.averaged else None,
        }[self.result.symmetry_outcome]

    def _discounted(self) -> str | None:
        weights = zip(self.scene.views, self.result.inlier_weights, strict=True)
        names = [view.name for view, weight in weights if weight < DOUBTFUL_INLIER_WEIGHT]
        return f"little of {', '.join(names)} (contradicted by the others)" if names else None

    def print_details(self) -> None:
        """Every measure and setting."""
        result = self.result
        best = f"best at step {result.best_step}"
        if result.averaged and result.best_step:
            best = f"the mean over the stages, the last one's {best}"
        click.echo(f"  steps  {result.steps}, {best}; ended: {result.stop_reason}")
        click.echo(
            f"  loss   {result.loss_before:.1f} -> {result.loss_after:.1f}   ({result.objective})"
        )
        click.echo(
            f"  Chamfer to the start x1000 {result.chamfer_to_initial * 1e3:.3f}   (squared, mean over points, both "
            "directions, longest side 1)"
        )
        click.echo(f"  IoU is {IOU_MEANS}")
        rows = zip(
            self.scene.views,
            result.view_ious,
            result.inlier_weights,
            result.view_weights,
            strict=True,
        )
        for view, (before, after), inlier, weight in rows:
            click.echo(
                f"  view   {before:.3f} -> {after:.3f}   inlier weight {inlier:.2f}, loss weight {weight:.2f}, {view.name}"
            )
        for view, camera, degrees, shift in (
            self.corrections if self.refine_camera and result.steps else ()
        ):
            text = f"turned {degrees:.2f} degrees, shifted {100.0 * shift:.2f} % of its distance   ({view.name})"
            if camera is view.camera:
                text = f"kept   (no small correction reduces the misfit to under {MISFIT_LEFT:g} of the initial one; {view.name})"
            click.echo(f"  camera {text}")
        click.echo(f"  mirror {self._mirror()}")
        for decision in result.budget[:-1]:
            click.echo(f"  spent  {decision.what}: {decision.choice} ({decision.reason})")
        click.echo(
            f"  sigma_sq {result.sigma_sq:g} (squared 64ths of the window), learning rate {result.learning_rate:g}, "
            f"gamma {result.gamma:g}, preset {result.preset}, {result.device}, "
            f"{self.seconds['optimise']:.2f} s in the loop, {self.seconds['total']:.2f} s in all"
        )

    def _mirror(self) -> str:
        if self.result.symmetry is None:
            return f"no plane: {self.result.symmetry_reason}"
        *normal, offset = self.result.symmetry
        terms = [
            f"{number:+.3f} {axis}"
            for number, axis in zip(normal, "xyz", strict=True)
            if abs(number) >= 5e-4
        ]
        return f"plane {' '.join(terms).lstrip('+')} = {offset:.4g}: {self.result.symmetry_reason}"
