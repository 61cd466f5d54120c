"""Priors on disk: safetensors in half precision, with what is known about them as JSON."""

from __future__ import annotations

import functools
import json
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError
from ..io.output import write_file
from ..io.reading import read_bytes, shown
from ..io.shipped import DEFAULT_PRIOR
from .network import shapes

FORMAT = "tso-prior-2"
METADATA_KEY = "tso"
EXPECTED = "a learned prior, as tso train-prior writes it"
# A prior has about 3 MB.
LARGEST = 64 << 20

Arrays = dict[str, np.ndarray[Any, Any]]


def packed_prior(weights: Arrays, about: dict[str, Any]) -> bytes:
    """The file of a prior: ``weights`` by the names and shapes of `shapes`, in half precision.

    ``about`` is JSON: how the prior was trained.
    """
    from safetensors.numpy import save

    for name, array in weights.items():
        if not (np.abs(array) <= np.finfo(np.float16).max).all():
            raise InputError(f"tensor {name} holds a number that is too large for half precision")
    halves = {name: np.asarray(weights[name], np.float16) for name in shapes()}
    document = json.dumps({"format": FORMAT, **about}, allow_nan=False, sort_keys=True)
    return bytes(save(halves, {METADATA_KEY: document}))


def write_prior(path: Path, weights: Arrays, about: dict[str, Any], overwrite: bool) -> None:
    """Write a whole file or nothing; InputError as `write_file`."""
    write_file(path, packed_prior(weights, about), overwrite)


def read_prior(path: Path, expected: str = EXPECTED) -> tuple[Arrays, dict[str, Any]]:
    """The weights of a prior, float64, and what is known about it.

    Raises InputError if the file is none that `write_prior` has written. Where there is no file to
    be read the message says what is ``expected``.
    """
    return _parsed(path, read_bytes(path, expected, limit=LARGEST))


@functools.lru_cache(maxsize=2)
def _parsed(path: Path, data: bytes) -> tuple[Arrays, dict[str, Any]]:
    """A batch parses its prior once."""
    from safetensors import SafetensorError
    from safetensors.numpy import load

    try:
        about = _about(data)
        weights = load(data)
    except (SafetensorError, ValueError, KeyError, TypeError, RecursionError) as error:
        fault = shown(str(error))
        raise InputError(
            f"{path}: is damaged or of another kind ({fault}), expected {EXPECTED}"
        ) from None
    if about.get("format") != FORMAT:
        fault = f"the format in its metadata is {shown(about.get('format'))}"
        raise InputError(f"{path}: {fault}, expected {FORMAT!r}: {EXPECTED}")
    for name, shape in shapes().items():
        if name not in weights:
            raise InputError(f"{path}: has no tensor {name}, expected shape {list(shape)}")
        if weights[name].shape != shape or weights[name].dtype != np.float16:
            fault = f"{weights[name].dtype} of shape {list(weights[name].shape)}"
            raise InputError(
                f"{path}: tensor {name} is {fault}, expected float16 of shape {list(shape)}"
            )
        if not np.isfinite(weights[name]).all():
            raise InputError(f"{path}: tensor {name} holds NaN or infinite, expected numbers")
    return {name: weights[name].astype(np.float64) for name in shapes()}, about


def shipped_prior() -> Path:
    """The prior that comes with the program; InputError if the installation lacks it."""
    if not DEFAULT_PRIOR.is_file():
        raise InputError(
            f"{DEFAULT_PRIOR}: the shipped prior is not in this installation, expected it there "
            "(or name a file, or none)"
        )
    return DEFAULT_PRIOR


def _about(data: bytes) -> dict[str, Any]:
    """The metadata in the header of a safetensors file; empty where they are of another kind."""
    length = int.from_bytes(data[:8], "little")
    if not 0 < length <= len(data) - 8:
        raise ValueError("no safetensors header")
    header = json.loads(data[8 : 8 + length])
    about = json.loads(header["__metadata__"][METADATA_KEY])
    return about if isinstance(about, dict) else {}
