"""`tso doctor`: what is installed, what works here, and how to get what is missing."""

from __future__ import annotations

import importlib
import os
import platform
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from typing import Any

import click

from ..errors import EXTRAS, missing_extra
from ..io.output import reason
from ..option import opt
from ..version import __version__
from . import options

# Modules of a plain report -> the packages that they are in.
NEEDED = {
    "numpy": "numpy", "scipy": "scipy", "PIL": "pillow", "skimage": "scikit-image",
    "trimesh": "trimesh", "yaml": "pyyaml", "threadpoolctl": "threadpoolctl", "click": "click",
}  # fmt: skip
# Modules whose packages have other names; open3d has two.
PACKAGES = {"open3d": ("open3d-cpu", "open3d"), "rerun": ("rerun-sdk",)}
SLOW = ("torch", "open3d")
"""What takes seconds to import."""


@dataclass(frozen=True, kw_only=True)
class DoctorOptions:
    """What `tso doctor` may be given.

    imports : Import torch and open3d too, which takes seconds: devices and faults.
    """

    imports: bool = opt(False)
    as_json: bool = options.as_json()


@options.command("doctor", DoctorOptions)
def command(ctx: click.Context, chosen: DoctorOptions) -> None:
    """Say what is installed, whether points mode works, and how to get what is missing.

    The exit code is 0 if points mode works, and 1 if not.
    """
    report = examined(chosen.imports)
    if chosen.as_json:
        options.echo_json(report)
    else:
        for name, words in _lines(report):
            click.echo(f"{name:<9}{words}")
    ctx.exit(0 if report["points_mode"]["works"] else 1)


def examined(imports: bool) -> dict[str, Any]:
    """What `tso doctor --json` prints."""
    from ..io.reading import free_memory
    from ..workers import cores

    extras: dict[str, list[str]] = {}
    for module, (_, extra) in EXTRAS.items():
        extras.setdefault(extra, []).append(module)
    return {
        "version": __version__,
        "python": platform.python_version(),
        "platform": f"{platform.system()} {platform.machine()}",
        "packages": {package: _version(module, package) for module, package in NEEDED.items()},
        "points_mode": _points_mode(),
        "extras": {name: _extra(name, modules, imports) for name, modules in extras.items()},
        "cores": os.cpu_count(),
        "processes": cores(),
        "free_memory_bytes": free_memory(),
        "devices": _devices() if imports else None,
    }


def _version(module: str, *packages: str) -> str | None:
    """The version of the package that ``module`` is in; None if it is missing."""
    try:
        if find_spec(module) is None:
            return None
    except (ImportError, ValueError):
        return None
    for package in packages:
        with suppress(PackageNotFoundError):
            return version(package)
    return "unknown"


def _extra(name: str, modules: list[str], imports: bool) -> dict[str, Any]:
    versions = {module: _version(module, *PACKAGES.get(module, (module,))) for module in modules}
    faults = {}
    for module in modules if imports else ():
        if versions[module] and module in SLOW and (fault := _fault(module)):
            faults[module] = fault
    return {
        "packages": versions,
        "complete": all(versions.values()) and not faults,
        "faults": faults,
        "install": f"pip install 'tso-cli[{name}]'",
    }


def _fault(module: str) -> str | None:
    """Why ``module`` cannot be imported, or None."""
    try:
        importlib.import_module(module)
    except (ImportError, OSError) as error:  # a library of the system is missing
        return reason(error)
    return None


def _points_mode() -> dict[str, Any]:
    """Whether three steps of the shipped chair work."""
    try:
        from .. import RefineConfig, read_camera, read_cloud, read_mask, refine
        from ..io.shipped import examples_folder

        chair = examples_folder() / "chair"
        mask = read_mask(chair / "mask.png")
        camera = read_camera(chair / "camera.json", mask.shape[1], mask.shape[0])
        cloud = read_cloud(chair / "initial.ply")
        refine(cloud.points, mask, camera, RefineConfig(steps=3))
    # Anything may be wrong with an report, and this command is there to say what.
    except Exception as error:
        return {"works": False, "error": missing_extra(error) or reason(error)}
    return {"works": True, "error": None}


def _devices() -> list[str]:
    """Where networks can run."""
    if _version("torch", "torch") is None or _fault("torch"):
        return []
    import torch

    count = torch.cuda.device_count() if torch.cuda.is_available() else 0
    gpus = [f"cuda:{number} ({torch.cuda.get_device_name(number)})" for number in range(count)]
    return ["cpu", *gpus, *(["mps"] if torch.backends.mps.is_available() else [])]


def _lines(report: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """A name and what is said of it, for each line."""
    yield "tso", f"{report['version']}, Python {report['python']}, {report['platform']}"
    packages = report["packages"]
    missing = [name for name, number in packages.items() if not number]
    yield "packages", ", ".join(f"{name} {number}" for name, number in packages.items() if number)
    if missing:
        yield "missing", f"{', '.join(missing)}: pip install {' '.join(missing)}"
    mode = report["points_mode"]
    yield "points", "points mode works" if mode["works"] else f"fails: {mode['error']}"
    for name, extra in report["extras"].items():
        parts = [
            f"{module} {number}" if number else f"{module} is missing"
            for module, number in extra["packages"].items()
        ]
        parts += [f"{module} fails: {why}" for module, why in extra["faults"].items()]
        yield name, ", ".join(parts) + ("" if extra["complete"] else f": {extra['install']}")
    yield "cores", f"{report['cores']}; a batch runs {report['processes']} at once"
    free = report["free_memory_bytes"]
    yield "memory", f"{free / 2**30:.1f} GiB free" if free < float("inf") else "unknown"
    devices = report["devices"]
    unknown = "not looked for: tso doctor --imports"
    yield "devices", unknown if devices is None else ", ".join(devices) or "none without torch"
