"""One generated shape, or folders full of them."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np

from ...errors import InputError
from ...io.meshes import Mesh, write_mesh
from ...io.output import check_output, reason
from . import airplane, car, chair

_MAKERS: dict[str, Callable[[np.random.Generator], Mesh]] = {
    "chair": chair.generate,
    "car": car.generate,
    "airplane": airplane.generate,
}
CATEGORIES = tuple(_MAKERS)
MOST = 100_000
"""Shapes of a category that fit the five digits of a file's name."""


def generate(category: str, rng: np.random.Generator) -> Mesh:
    """One shape.

    Parameters
    ----------
    category : one of `CATEGORIES`.
    rng : where the randomness comes from: the same state gives the same shape.

    Returns
    -------
    A mesh of closed parts, in metres or in lengths of the shape; y up, front +z (chair, car) or -x (airplane).

    Raises
    ------
    InputError
        There is no such category.
    """
    _check_category(category)
    return _MAKERS[category](rng)


def write_shapes(
    output: Path | str,
    counts: dict[str, int],
    seed: int = 0,
    progress: Callable[[int, int, str], None] | None = None,
    overwrite: bool = False,
) -> list[Path]:
    """Write ``counts[category]`` shapes of each category to ``output``/CATEGORY/gen_00000.ply and so on.

    A shape depends on ``seed``, its category and its number alone: asking for more gives the same ones first.

    Parameters
    ----------
    progress : called with shapes written, shapes in all and the name of the last one.

    Returns
    -------
    The files written, in order.

    Raises
    ------
    InputError
        A category is not known, a count or the seed is out of range, or a file is there and ``overwrite`` is false: then
        nothing is written. Or a folder or file cannot be written.
    """
    output = Path(output)
    if seed < 0:
        raise InputError(f"seed is {seed}, expected 0 or more")
    for category, count in counts.items():
        _check_category(category)
        if not 0 <= count <= MOST:
            raise InputError(f"asked for {count} shapes of category {category}, expected 0 to {MOST:,}")
    wanted = {(name, k): output / name / f"gen_{k:05d}.ply" for name, count in counts.items() for k in range(count)}
    if not wanted:
        raise InputError("asked for no shape at all, expected at least one")
    for folder in (output, *dict.fromkeys(path.parent for path in wanted.values())):
        try:
            folder.mkdir(exist_ok=True)
        except OSError as error:
            raise InputError(f"{folder}: cannot be made a folder ({reason(error)})") from None
    for path in wanted.values():
        check_output(path, overwrite)
    for done, ((category, k), path) in enumerate(wanted.items()):
        rng = np.random.default_rng([seed, zlib.crc32(category.encode()), k])
        write_mesh(path, generate(category, rng), overwrite)
        if progress is not None:
            progress(done + 1, len(wanted), f"{category}/{path.stem}")
    return list(wanted.values())


def _check_category(category: str) -> None:
    if category not in _MAKERS:
        raise InputError(f"{category!r} is not a category, expected {', '.join(CATEGORIES)}")
