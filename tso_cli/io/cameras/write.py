"""Writes camera files: tso's own format."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ..output import write_file
from .record import CameraRecord


def write_cameras(path: Path, records: Sequence[CameraRecord], overwrite: bool = False) -> None:
    """Write a camera file that reads back exactly.

    A single record without files is written as one camera, anything else as views.
    """
    write_file(path, camera_text(path, records).encode(), overwrite)


def camera_text(path: Path, records: Sequence[CameraRecord]) -> str:
    """The text that `write_cameras` writes; paths in it are relative to the file ``path``."""
    views = [_as_json(record, path) for record in records]
    if len(records) == 1 and records[0].mask is None and records[0].image is None:
        return _lines(views[0], "") + "\n"
    listed = ",\n    ".join(_lines(view, "    ") for view in views)
    return f'{{\n  "views": [\n    {listed}\n  ]\n}}\n'


def _lines(view: dict[str, Any], indent: str) -> str:
    """One key per line; a matrix stays on the line of its key."""
    entries = [f"{indent}  {json.dumps(key)}: {json.dumps(value)}" for key, value in view.items()]
    return "{\n" + ",\n".join(entries) + f"\n{indent}}}"


def _as_json(record: CameraRecord, path: Path) -> dict[str, Any]:
    folder, camera = os.path.realpath(path.parent), record.camera
    files = {"mask": record.mask, "image": record.image}
    return {
        **{
            key: Path(os.path.relpath(os.path.realpath(file), folder)).as_posix()
            for key, file in files.items()
            if file
        },
        **{"width": camera.width, "height": camera.height, "model": camera.model},
        **{"K": camera.K.tolist(), "R": camera.R.tolist(), "t": camera.t.tolist()},
    }
