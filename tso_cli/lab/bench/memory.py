"""Peak memory of a contestant, in a process of its own: ``python -m tso_cli.lab.bench.memory JSON``."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .timing import Setting, Work, gradient, threads

if TYPE_CHECKING:
    from torch import Tensor

    from .peers import Term

# Give what is freed back to the system at once, or what was freed before the call would hide what the call takes (glibc).
FRANK = {"MALLOC_MMAP_THRESHOLD_": "16384", "MALLOC_TRIM_THRESHOLD_": "16384"}
# Enough points for the compiled loops to be loaded before the measurement.
WARM = (8192, 32)
MEASURED = ("silhouette", "chamfer")


def add_peaks(records: list[dict[str, Any]], setting: Setting) -> None:
    """Set ``peak_memory_bytes`` of ``records``, silhouettes and Chamfer distances that ran."""
    for record in records:
        if record["name"] != "tso, built once":
            setting.report(f"memory of {record['name']}, {record['points']:,} points")
            record["peak_memory_bytes"] = peak(record, setting.seed)


def peak(record: dict[str, Any], seed: int) -> int | None:
    """Bytes by which the call that ``record`` is of raises the peak of a fresh process; None where that cannot be told."""
    task = {key: record[key] for key in ("what", "name", "points", "side", "device", "threads")} | {"seed": seed}
    package = str(Path(__file__).resolve().parents[2])
    paths = os.pathsep.join(filter(None, (package, os.environ.get("PYTHONPATH"))))
    done = subprocess.run(
        [sys.executable, "-m", __name__, json.dumps(task)],
        env=os.environ | FRANK | {"PYTHONPATH": paths},
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        check=False,
    )
    # what it prints before is another package's
    return json.loads(done.stdout.splitlines()[-1]) if done.returncode == 0 and done.stdout.strip() else None


def _measured(task: dict[str, Any]) -> int | None:
    import torch

    setting = Setting(torch.device(task["device"]), task["threads"], full=True, seed=task["seed"])
    with threads(setting.threads):
        # The compiled loops, and what this contestant loads.
        _work("silhouette", "compiled" if setting.device.type == "cpu" else "windowed", *WARM, setting)()
        _work(task["what"], task["name"], 64, 16, setting)()
        work = _work(task["what"], task["name"], task["points"], task["side"] or 0, setting)
        if setting.device.type == "cuda":
            before = torch.cuda.memory_allocated(setting.device)
            torch.cuda.reset_peak_memory_stats(setting.device)
            work()
            return torch.cuda.max_memory_allocated(setting.device) - before
        with suppress(OSError):
            # From here the mark starts at what is resident now (Linux; elsewhere it only rises).
            Path("/proc/self/clear_refs").write_text("5")
        held = _high_water()
        work()
        reached = _high_water()
    return None if held is None or reached is None else reached - held


def _work(what: str, name: str, count: int, side: int, setting: Setting) -> Work:
    """One call of a contestant; what it keeps between calls is made inside."""
    from . import chamfer, peers, silhouette
    from .material import projection, trajectory

    if what == "silhouette":
        scene = projection(count, side, setting.device, setting.seed)
        drawn = peers.splatters(scene).get(name)
        return (lambda: _once(drawn(), scene.points)) if drawn else silhouette.work(name, scene)
    start, *_, moved = trajectory(count, setting.device, setting.seed, steps=2)
    return lambda: _once(chamfer.makers(start, setting)[name](), moved)


def _once(term: Term | str, points: Tensor) -> None:
    if isinstance(term, str):
        raise RuntimeError(term)
    gradient(term, points)()


def _high_water() -> int | None:
    """The most bytes that were resident so far."""
    with suppress(OSError):
        # Not what `getrusage` says: a child begins with the mark of the process that started it.
        for line in Path("/proc/self/status").read_text().splitlines():
            if line.startswith("VmHWM"):
                return 1024 * int(line.split()[1])
    if sys.platform == "darwin":
        import resource

        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return None


if __name__ == "__main__":
    print(json.dumps(_measured(json.loads(sys.argv[1]))))
