"""Chairs, cars and aeroplanes drawn by rule, to train on where real shapes are few.

y is up. Chairs and cars face +z and are symmetric about x = 0; aeroplanes fly toward -x and are symmetric about z = 0.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np

from ...errors import InputError
from ...io.meshes import Mesh, write_mesh
from ...io.output import check_output, reason
from . import airplane, car, chair
from .parts import join, pick

_MAKERS = {"chair": chair, "car": car, "airplane": airplane}
CATEGORIES = tuple(_MAKERS)
# Shapes of a category that fit the five digits of a file's name.
MOST = 100_000


def generate(category: str, rng: np.random.Generator) -> Mesh:
    """A shape of closed parts, y up, front +z (chair, car) or -x (airplane); the same state of ``rng`` gives the same one.

    category : one of `CATEGORIES`.
    """
    maker = _MAKERS[category]
    mesh = join(maker.build(rng, pick(rng, maker.WEIGHTS)))
    return Mesh(mesh.vertices * np.exp(rng.normal(0.0, maker.SPREAD, 3)), mesh.faces)


def write_shapes(
    output: Path | str,
    counts: dict[str, int],
    seed: int = 0,
    progress: Callable[[int, int, str], None] | None = None,
    overwrite: bool = False,
) -> list[Path]:
    """Write ``counts[category]`` shapes of each category to ``output``/CATEGORY/gen_00000.ply and so on.

    A shape depends on ``seed``, its category and its number alone: asking for more gives the same ones first.

    ``progress`` is called with shapes written, shapes in all and the name of the last one. Returns the files, in order.

    Raises InputError if a count is out of range, or a file exists and ``overwrite`` is false: then nothing is written. Or if a
    folder or file cannot be written.
    """
    output = Path(output)
    for category, count in counts.items():
        if not 0 <= count <= MOST:
            raise InputError(
                f"asked for {count} shapes of category {category}, expected 0 to {MOST:,}"
            )
    paths = {
        (name, k): output / name / f"gen_{k:05d}.ply"
        for name, count in counts.items()
        for k in range(count)
    }
    if not paths:
        raise InputError("asked for no shape at all, expected at least one")
    for folder in (output, *dict.fromkeys(path.parent for path in paths.values())):
        try:
            folder.mkdir(exist_ok=True)
        except OSError as error:
            raise InputError(f"{folder}: cannot be made a folder ({reason(error)})") from None
    for path in paths.values():
        check_output(path, overwrite)
    for done, ((category, k), path) in enumerate(paths.items(), 1):
        rng = np.random.default_rng([seed, zlib.crc32(category.encode()), k])
        write_mesh(path, generate(category, rng), overwrite)
        if progress is not None:
            progress(done, len(paths), f"{category}/{path.stem}")
    return list(paths.values())
