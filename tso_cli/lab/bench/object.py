"""One object: `refine` in this process, and its first call in a fresh one."""

from __future__ import annotations

import json
import pickle
import tempfile
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ...refinement import PRESETS, RefineConfig, refine
from .material import chair_views, cloud
from .timing import FORMS, IMPORT_TORCH, Contestant, Records, Setting, run_process, timed

SIZES, LARGE = (1024, 16384), (65536, 262144)
# Numbers of views of the default preset, at the smallest size.
MORE_VIEWS = (2, 4)


@dataclass(frozen=True, eq=False)
class Call:
    """One call of `refine` with the loops in one form; ``steady`` here, else in a fresh process.

    ``details`` are what each call says of itself: the seconds of its phases, or the peak memory of its process.
    """

    arguments: tuple[Any, Any, RefineConfig]
    form: str
    steady: bool
    details: list[dict[str, float]] = field(default_factory=list)

    def __call__(self) -> float:
        points, views, config = self.arguments
        if self.steady:
            return timed(lambda: self.details.append(refine(points, views, config=config).seconds), self.form)()
        with tempfile.NamedTemporaryFile(suffix=".pickle") as file:
            file.write(pickle.dumps((*self.arguments, self.form)))
            file.flush()
            answer = json.loads(run_process("refine", ("-m", "tso_cli.lab.bench.first_call", file.name))[1])
        self.details.append({"peak_memory_bytes": answer["peak_memory_bytes"]})
        return float(answer["seconds"])

    @property
    def fields(self) -> dict[str, Any]:
        """Medians of the details, as fields of a record."""
        medians = {key: float(np.median([detail[key] for detail in self.details])) for key in self.details[0]}
        return {"phases": medians} if self.steady else medians


def measure(setting: Setting, sizes: tuple[int, ...] = (), steps: int | None = None) -> Records:
    """Both presets in both forms of the loops at every size, and the default with more views."""
    sizes = sizes or ((*SIZES, *LARGE) if setting.full else SIZES)
    cases = [(preset, points, 1) for points in sizes for preset in PRESETS]
    cases += [("best", sizes[0], views) for views in MORE_VIEWS]
    contestants, calls = [IMPORT_TORCH], []
    for preset, points, views in cases:
        config = RefineConfig(preset=preset, steps=steps, seed=setting.seed)
        arguments = cloud(points, setting.seed), chair_views(views), config
        for form in FORMS:
            for call in ("steady", "first"):
                calls.append(Call(arguments, form, call == "steady"))
                fields = {"points": points, "preset": preset, "views": views, "form": form, "call": call}
                name = f"{preset}, {form}" + (", first call" if call == "first" else "")
                contestants.append(Contestant(name, calls[-1], fields))
    torch, *records = setting.race("object", contestants, "over_import_torch")
    return [torch, *(record | call.fields for record, call in zip(records, calls, strict=True))]
