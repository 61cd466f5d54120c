"""Projected points -> sums -> cross-entropy -> derivative by the points, as compiled loops on the CPU in one call."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from .jit import compiled, part, share
from .losses_numba import WithSlope, entropy_of_row, pull_image
from .nearest_numba import cell_edge
from .splat_numba import add_band, bands_for, project_back, window, work

# Basic steps that a pixel costs.
PER_PIXEL = 8
# What is done: everything; the sums and their loss; the far pixels; the way back to the points.
ALL, COVER, PULL, BACK = range(4)


def mask_loss(
    points_px: Tensor, valid: Tensor, wanted: Tensor, unwanted: Tensor, sigma_sq: float, radius: int, uncovered: float
) -> Tensor:
    """Sum [M] over pixels of the cross-entropy, with the pull of mask pixels whose sum is at most ``uncovered``.

    ``points_px`` [M, N, 2] and ``valid`` [M, N] are projected points, ``wanted`` and ``unwanted`` [M, H, W] the weights of the
    mask and of its complement. See `mask_loss`.
    """
    images, count = valid.shape
    height, width = wanted.shape[-2:]
    kernel = window(sigma_sq, radius, points_px)
    total, slope = points_px.new_empty(images), torch.zeros_like(points_px, memory_format=torch.contiguous_format)
    stride = 2 * radius + width + len(kernel.steps)
    pixels = (
        points_px.new_empty(images, height, stride).numpy(),
        np.empty((images, height, width), np.bool_),
        np.empty((images, height)),
        np.empty((images, height), np.int64),
    )
    edge, pull = cell_edge(height, width, count), 0.5 / sigma_sq
    taps, own = work(images, count, radius), PER_PIXEL * wanted.numel()
    with_slope = points_px.requires_grad

    def run(units: int, steps: int, stage: int, bands: int = 1) -> None:
        share(units, steps, _run, stage, bands, points_px, valid, wanted, unwanted, kernel, uncovered, edge, pull, pixels,
              with_slope, total, slope)  # fmt: skip

    if images >= torch.get_num_threads():
        run(images, 2 * taps + own, ALL)
    else:
        bands = bands_for(images, height, radius)
        run(images * bands, taps + own, COVER, bands)
        run(images, own, PULL)
        run(images * count, taps, BACK)
    value: Tensor = WithSlope.apply(points_px, total, slope)
    return value


@part
def _cover(first, last, points, valid, wanted, unwanted, kernel, uncovered, bands, pixels):  # type: ignore[no-untyped-def]
    """Fill ``padded`` with the derivative by the sums, for the bands ``first`` to ``last``, counted through all images."""
    padded, asking, loss, waiting = pixels
    height, width = wanted.shape[1:]
    left = 2 * kernel.radius
    for task in range(first, last):
        image, band = task // bands, task % bands
        top, bottom = band * height // bands, (band + 1) * height // bands
        add_band(points[image], valid[image], kernel, top, bottom, padded[image, top:bottom])
        for i in range(top, bottom):
            line = padded[image, i]
            line[:left] = 0.0
            line[left + width :] = 0.0
            loss[image, i], waiting[image, i] = entropy_of_row(
                line[left : left + width], wanted[image, i], unwanted[image, i], uncovered, asking[image, i]
            )


@part
def _pull(first, last, points, valid, wanted, edge, pull, pixels, total, slope):  # type: ignore[no-untyped-def]
    """Add up the loss of the images ``first`` to ``last``, with that of the pixels that wait for a point."""
    _, asking, loss, waiting = pixels
    for image in range(first, last):
        value = pull_image(asking[image], waiting[image], wanted[image], points[image], valid[image], pull, edge, slope[image])
        for i in range(loss.shape[1]):
            value += loss[image, i]
        total[image] = value


@compiled
def _run(  # type: ignore[no-untyped-def]
    first, last, stage, bands, points, valid, wanted, unwanted, kernel, uncovered, edge, pull, pixels, with_slope, total, slope
):
    """One stage for a range of bands, images or points; or all, image by image, so that each finds its pixels still at hand.

    Every stage is called at one place: compiled into two, it could be rounded in two ways.
    """
    count = points.shape[1]
    for unit in range(first, last if stage == ALL else first + 1):
        every = stage == ALL
        start, stop = (unit, unit + 1) if every else (first, last)
        if every or stage == COVER:
            _cover(start, stop, points, valid, wanted, unwanted, kernel, uncovered, bands, pixels)
        if every or stage == PULL:
            _pull(start, stop, points, valid, wanted, edge, pull, pixels, total, slope)
        if with_slope and (every or stage == BACK):
            if every:
                start, stop = start * count, stop * count
            project_back(start, stop, points, valid, kernel, pixels[0], slope)
