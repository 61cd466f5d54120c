"""What the commands write for the shipped examples, as digests, to see that a change of the code changes no result.

python -m tests.pins pins.json            writes the digests
python -m tests.pins pins.json --check    compares with those, names what differs, and exits with 1 if anything does

Results are the same to the last bit on one machine with one version of its libraries, not from one machine to another: the
file is made before a change and thrown away after it.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import os
import shutil
import sys
import tempfile
from pathlib import Path
from typing import Any

# The number of threads shows in the last digits of what BLAS computes.
os.environ["OMP_NUM_THREADS"] = "1"

from tests.readme import working_copy
from tso_cli.cli import main as tso

EXAMPLES = ("chair", "car", "airplane")
MODES = ("points", "encoder", "encoder-decoder", "latent")
PRESETS = ("best", "paper")
# Values that a clock or the place of the files decides.
FLEETING = ("seconds", "images_per_second", "version", "output", "state", "checkpoint")


def commands() -> dict[str, list[str]]:
    """Name -> words of a command; what it writes is named after it."""
    found = {}
    for example in EXAMPLES:
        folder = f"examples/{example}"
        mask, camera = f"{folder}/mask.png", ["--camera", f"{folder}/camera.json"]
        for mode in MODES:
            for preset in PRESETS:
                if mode == "latent" and preset == "paper":
                    continue
                start = [f"{folder}/initial.ply", mask] if mode == "points" else [f"{folder}/image.png", mask]
                found[f"{example} {mode} {preset}"] = ["refine", "--mode", mode, *start, *camera, "--preset", preset]
        points = ["refine", "--mode", "points", f"{folder}/initial.ply"]
        found[f"{example} two masks"] = [*points, mask, f"{folder}/second.png"]
        found[f"{example} camera refined"] = [*points, mask, *camera, "--refine-camera"]
        found[f"{example} no symmetry"] = [*points, mask, *camera, "--symmetry", "none"]
        found[f"{example} mesh"] = ["refine", "--mode", "points", next(_meshes(example)), mask, *camera]
        found[f"{example} check"] = [*points, mask, *camera, "--check"]
        found[f"{example} eval"] = ["eval", f"{folder}/initial.ply", f"{folder}/target.ply", "--chamfer", "--f-score"]
    found["chair in a photo"] = ["refine", "--mode", "points", "examples/chair/initial.ply", "examples/photo/mask.png"]
    found["chair, no camera"] = [*found["chair in a photo"][:4], "examples/chair/mask.png", "--camera", "fit"]
    return found


def _second_views(folder: Path) -> None:
    """The first mask of every example again, from a camera that stands elsewhere: a view that the first contradicts."""
    for example in EXAMPLES:
        own = folder / "examples" / example
        shutil.copy(own / "mask.png", own / "second.png")
        camera = json.loads((own / "camera.json").read_text())
        camera["R"] = [camera["R"][2], camera["R"][1], [-value for value in camera["R"][0]]]
        (own / "second.camera.json").write_text(json.dumps(camera))


def _meshes(example: str) -> Any:
    return (str(path) for path in sorted(Path("examples/meshes", example).glob("*.ply")))


def pins() -> dict[str, str]:
    """Name -> digest of the cloud and of the JSON document, times aside."""
    made = {}
    for number, (name, words) in enumerate(commands().items(), 1):
        written = words[0] == "refine" and "--check" not in words
        output = Path(f"{number}.ply")
        printed = io.StringIO()
        with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(io.StringIO()):
            try:
                tso([*words, *(["-o", str(output)] if written else []), "--json"])
            except SystemExit as stopped:
                code = stopped.code or 0
        assert code == 0, f"{' '.join(words)} ended with {code}"
        content = output.read_bytes() if written and output.exists() else b""
        text = printed.getvalue()
        document = json.dumps(_lasting(json.loads(text)), sort_keys=True) if text else ""
        made[name] = hashlib.sha256(content + document.encode()).hexdigest()[:16]
        print(f"\r{number} of {len(commands())}", end="", file=sys.stderr)
    print(file=sys.stderr)
    return made


def _lasting(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _lasting(own) for key, own in value.items() if key not in FLEETING}
    return [_lasting(own) for own in value] if isinstance(value, list) else value


def main(arguments: list[str]) -> int:
    file = Path(arguments[0]).resolve()
    with tempfile.TemporaryDirectory() as folder:
        working_copy(Path(folder))
        _second_views(Path(folder))
        os.chdir(folder)
        found = pins()
    if "--check" not in arguments:
        file.write_text(json.dumps(found, indent=1))
        return 0
    before = json.loads(file.read_text())
    other = [name for name in sorted(before | found) if before.get(name) != found.get(name)]
    print("\n".join(other) if other else f"all {len(found)} as before")
    return 1 if other else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
