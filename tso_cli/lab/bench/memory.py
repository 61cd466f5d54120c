"""Peak memory of a contestant, in a process of its own: ``python -m tso_cli.lab.bench.memory JSON``."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

import torch

from . import chamfer, peers, silhouette
from .material import projection, trajectory
from .timing import Setting, Work, gradient, threads

ROOT = Path(__file__).resolve().parents[3]
# glibc returns freed memory at once; else what an earlier call freed would hide what this one takes.
RETURN_FREED = {"MALLOC_MMAP_THRESHOLD_": "16384", "MALLOC_TRIM_THRESHOLD_": "16384"}
# Enough points to load the compiled loops before the measurement.
WARM = (8192, 32)
# Each process takes three seconds: only this size and the largest are measured.
MEASURED_POINTS = 16384


def add_peaks(records: list[dict[str, Any]], setting: Setting) -> None:
    """Set ``peak_memory_bytes`` of the silhouettes and Chamfer distances at 16,384 points and at the largest size."""
    for what in ("silhouette", "chamfer"):
        measured = [r for r in records if r["what"] == what and r["runs"] and r["name"] != chamfer.BUILT]
        largest = max((record["points"] for record in measured), default=0)
        for record in measured:
            if record["points"] in (MEASURED_POINTS, largest):
                setting.report(f"memory of {record['name']}, {record['points']:,} points")
                record["peak_memory_bytes"] = peak(record, setting.seed)


def peak(record: dict[str, Any], seed: int) -> int | None:
    """Bytes that one call of the record's contestant adds to the peak of a fresh process; None where that is not known."""
    task = {key: record[key] for key in ("what", "name", "points", "side", "device", "threads")} | {"seed": seed}
    paths = os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH"))))
    done = subprocess.run(
        [sys.executable, "-m", __name__, json.dumps(task)],
        env=os.environ | RETURN_FREED | {"PYTHONPATH": paths},
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        check=False,
    )
    # Other packages may print before the answer.
    return json.loads(done.stdout.splitlines()[-1]) if done.returncode == 0 and done.stdout.strip() else None


def _measured(task: dict[str, Any]) -> int | None:
    setting = Setting(torch.device(task["device"]), task["threads"], full=True, seed=task["seed"])
    with threads(setting.threads):
        # Load the compiled loops and the contestant's libraries.
        _work("silhouette", silhouette.kernels(setting.device)[0], *WARM, setting)()
        _work(task["what"], task["name"], 64, 16, setting)()
        work = _work(task["what"], task["name"], task["points"], task["side"] or 0, setting)
        if setting.device.type == "cuda":
            before = torch.cuda.memory_allocated(setting.device)
            torch.cuda.reset_peak_memory_stats(setting.device)
            work()
            return torch.cuda.max_memory_allocated(setting.device) - before
        with suppress(OSError):
            # Linux then counts the peak from what is resident now.
            Path("/proc/self/clear_refs").write_text("5")
        before_bytes = _peak_resident()
        work()
        after_bytes = _peak_resident()
    return None if before_bytes is None or after_bytes is None else after_bytes - before_bytes


def _work(what: str, name: str, count: int, side: int, setting: Setting) -> Work:
    """One call of a contestant, including what it builds once."""
    if what == "silhouette":
        scene = projection(count, side, setting.device, setting.seed)
        make = peers.splatters(scene).get(name)
        return (lambda: _once(make(), scene.points)) if make else silhouette.work(name, scene)
    initial, *_, moved = trajectory(count, setting.device, setting.seed, steps=2)
    return lambda: _once(chamfer.makers(initial, setting)[name](), moved)


def _once(term: peers.Term | str, points: torch.Tensor) -> None:
    if isinstance(term, str):
        raise RuntimeError(term)
    gradient(term, points)()


def _peak_resident() -> int | None:
    with suppress(OSError):
        # `getrusage` would start from the peak of the parent process.
        for line in Path("/proc/self/status").read_text().splitlines():
            if line.startswith("VmHWM"):
                return 1024 * int(line.split()[1])
    if sys.platform == "darwin":
        import resource

        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return None


if __name__ == "__main__":
    print(json.dumps(_measured(json.loads(sys.argv[1]))))
