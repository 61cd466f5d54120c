"""Networks on disk: safetensors with the configuration as JSON in the metadata, never pickles.

A checkpoint holds the network's tensors under their own names. It may also hold the state of an
unfinished training, under names that start with ``training.``; a reader of networks ignores them.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import InputError
from ..option import declared
from .output import reason, write_file
from .reading import read_bytes, shown

if TYPE_CHECKING:
    import torch
    from torch import Tensor

    from ..network.model import BaseNetwork, NetworkConfig

FORMAT = "tso-network-1"
# There is a single key: safetensors writes several keys in an order that differs from run to run.
METADATA_KEY = "tso"
STATE_PREFIX = "training."
_PICKLES = (b"PK\x03\x04", b"\x80\x02", b"\x80\x03", b"\x80\x04", b"\x80\x05")  # first bytes
# What safetensors and torch raise for damaged files, besides SafetensorError.
_DAMAGE_ERRORS = (OSError, ValueError, TypeError, KeyError, RuntimeError, AttributeError)


def save_network(
    path: Path,
    network: BaseNetwork,
    config: NetworkConfig,
    overwrite: bool = False,
    dtype: torch.dtype | None = None,
) -> None:
    """Write one safetensors file with the weights as ``dtype`` (None: the type that they have).

    Raises InputError if a weight is too large for ``dtype``.
    """
    tensors = network.state_dict()
    if dtype is not None:
        tensors = {name: tensor.to(dtype) for name, tensor in tensors.items()}
        too_large = next(
            (name for name, tensor in tensors.items() if not tensor.isfinite().all()), None
        )
        if too_large:
            raise InputError(
                f"{path}: tensor {too_large} holds a number too large for {dtype}, "
                "nothing was written"
            )
    save_tensors(path, tensors, config, {}, overwrite)


def save_tensors(
    path: Path,
    tensors: dict[str, Tensor],
    config: NetworkConfig,
    state: dict[str, Any],
    overwrite: bool = False,
) -> None:
    """Write network tensors, ``training.*`` tensors and the training ``state`` (JSON) to a file."""
    about = {"config": dataclasses.asdict(config), **({"training": state} if state else {})}
    write_tensors(path, tensors, FORMAT, about, overwrite)


def write_tensors(
    path: Path,
    tensors: dict[str, Tensor],
    file_format: str,
    about: dict[str, Any],
    overwrite: bool = False,
) -> None:
    """Write tensors, and ``about`` (JSON) as the metadata of a file of this format."""
    from safetensors.torch import save

    document = {"format": file_format, **about}
    metadata = {METADATA_KEY: json.dumps(document, sort_keys=True, allow_nan=False)}
    # save_file would make the file readable only for its owner.
    data = save(
        {name: tensor.detach().cpu().contiguous() for name, tensor in tensors.items()}, metadata
    )
    write_file(path, data, overwrite)


def load_network(path: Path) -> tuple[BaseNetwork, NetworkConfig]:
    """Read a network: float32, on the CPU, in evaluation mode.

    Raises InputError if its tensors do not fit its configuration.
    """
    import torch

    from ..network.model import BaseNetwork, Decoder, Encoder

    config, _ = read_metadata(path)
    with torch.device("meta"):  # takes no memory: the file is checked first
        network = BaseNetwork(Encoder(), Decoder(config.points))
    expected = {name: tuple(tensor.shape) for name, tensor in network.state_dict().items()}
    tensors = read_tensors(path, expected, lambda name: not name.startswith(STATE_PREFIX))
    network.load_state_dict(
        {name: tensors[name].to(torch.float32) for name in expected}, assign=True
    )
    for parameter in network.parameters():
        parameter.requires_grad_(True)
    return network.eval(), config


def load_state(path: Path, expected: dict[str, tuple[int, ...]]) -> dict[str, Tensor]:
    """Read the ``training.*`` tensors of ``path``; the returned names lack this prefix.

    Raises InputError if names or shapes differ from ``expected``.
    """
    state = {STATE_PREFIX + name: shape for name, shape in expected.items()}
    tensors = read_tensors(path, state, lambda name: name.startswith(STATE_PREFIX))
    return {name.removeprefix(STATE_PREFIX): tensor for name, tensor in tensors.items()}


def read_metadata(path: Path) -> tuple[NetworkConfig, dict[str, Any]]:
    """The configuration in a checkpoint, and the training state in it (empty if there is none)."""
    about = read_about(path, FORMAT)
    for key in ("config", "training"):
        if not isinstance(about.get(key, {}), dict):
            raise InputError(
                f"{path}: {key!r} in the metadata is {shown(about[key])}, expected a JSON object"
            )
    if "config" not in about:
        raise InputError(
            f"{path}: the metadata has no 'config', expected the network's configuration"
        )
    return _config(path, about["config"]), about.get("training", {})


def read_about(path: Path, file_format: str) -> dict[str, Any]:
    """The metadata (JSON) of a file of this format, as `write_tensors` writes it.

    Raises InputError if the file has another format or is damaged.
    """
    from safetensors import SafetensorError, safe_open

    _refuse_other_files(path)
    try:
        with safe_open(path, framework="pt") as file:
            metadata = file.metadata() or {}
    except (SafetensorError, OSError, ValueError) as error:
        raise InputError(f"{path}: {_damage(error)}, expected a whole safetensors file") from None
    if METADATA_KEY not in metadata:
        raise InputError(
            f"{path}: a safetensors file without {METADATA_KEY!r} in its metadata, "
            "expected a file that tso train has written"
        )
    try:
        about = json.loads(metadata[METADATA_KEY])
    except (ValueError, RecursionError):
        raise InputError(
            f"{path}: the metadata is {shown(metadata[METADATA_KEY])}, expected JSON"
        ) from None
    version = about.get("format") if isinstance(about, dict) else about
    if not isinstance(about, dict) or version != file_format:
        raise InputError(
            f"{path}: the format in the metadata is {shown(version)}, "
            f"expected {file_format!r} (as tso train writes it)"
        )
    return about


def _refuse_other_files(path: Path) -> None:
    expected = "a checkpoint (.safetensors)"
    start = read_bytes(path, expected, most=16)
    # A safetensors file starts with 8 bytes of length, which may look like a pickle, and a brace.
    if start[8:9] == b"{":
        return
    if start.startswith(_PICKLES):
        raise InputError(
            f"{path}: is a pickled PyTorch file; loading it could run code; expected safetensors"
        )
    size = path.stat().st_size
    raise InputError(
        f"{path}: is not a safetensors file ({size:,} bytes, starts with {start[:8]!r}), "
        f"expected {expected}"
    )


def _damage(error: Exception) -> str:
    text = reason(error).removeprefix("Error while deserializing header: ")
    truncated = "incomplete metadata" in text or "invalid header length" in text
    return f"{'truncated or ' if truncated else ''}damaged ({shown(text)})"


def _config(path: Path, values: dict[str, Any]) -> NetworkConfig:
    from ..network.model import NetworkConfig

    names = [field.name for field in dataclasses.fields(NetworkConfig)]
    problems = [f"lacks {name!r}" for name in names if name not in values]
    problems += [f"holds the unknown {shown(name)}" for name in values if name not in names]
    if problems:
        raise InputError(f"{path}: the configuration {problems[0]}, expected {', '.join(names)}")
    for name, entry in declared(NetworkConfig).items():
        if not entry.takes(values[name]):
            raise InputError(
                f"{path}: {name} in the configuration is {shown(values[name])}, expected "
                f"{entry.expected}"
            )
    if not isinstance(values["settings"], dict):
        raise InputError(f"{path}: settings in the configuration is no JSON object, expected one")
    return NetworkConfig(**values)


def read_tensors(
    path: Path,
    expected: dict[str, tuple[int, ...]],
    belongs: Callable[[str], bool] = lambda name: True,
) -> dict[str, Tensor]:
    """The tensors of ``path`` whose names ``belong``, once names, shapes and values are checked.

    Raises InputError if names or shapes differ from ``expected``, or a number is not finite.
    """
    import torch
    from safetensors import SafetensorError, safe_open

    tensors = {}
    try:
        with safe_open(path, framework="pt") as file:
            names = [name for name in file.keys() if belongs(name)]  # noqa: SIM118
            shapes = {name: file.get_slice(name).get_shape() for name in names}
            for name, shape in expected.items():
                if name not in shapes:
                    raise InputError(
                        f"{path}: tensor {name} is missing, expected shape {list(shape)}"
                    )
                if tuple(shapes[name]) != shape:
                    raise InputError(
                        f"{path}: tensor {name} has shape {list(shapes[name])}, "
                        f"expected {list(shape)} (a network of another size?)"
                    )
            if unknown := sorted(set(shapes) - set(expected)):
                raise InputError(
                    f"{path}: has the unknown tensor {shown(unknown[0])} of shape "
                    f"{list(shapes[unknown[0]])}, expected only tensors of the network"
                )
            for name in expected:
                # The tensor is a view of the file, which may change while it is in use. It is also
                # not aligned as torch aligns tensors, which would change the last bits of results.
                tensors[name] = file.get_tensor(name).clone()
    except (SafetensorError, *_DAMAGE_ERRORS) as error:
        raise InputError(f"{path}: {_damage(error)}, expected a whole safetensors file") from None
    for name, tensor in tensors.items():
        if not tensor.is_floating_point():
            raise InputError(
                f"{path}: tensor {name} holds {tensor.dtype}, expected floating-point numbers"
            )
        bad = int((~torch.isfinite(tensor.float())).sum())
        if bad:
            raise InputError(
                f"{path}: tensor {name} holds {bad} numbers that are not finite (NaN or infinite), "
                "expected finite numbers"
            )
    return tensors
