"""What the commands write for the shipped examples, as digests, to see that a change of the code
changes no result.

python -m tests.pins pins.json            writes the digests
python -m tests.pins pins.json --check    compares with those, names what differs, and exits with 1
if anything does

Results are the same to the last bit on one machine with one version of its libraries, not from one
machine to another: the file is made before a change and thrown away after it.
"""

import contextlib
import hashlib
import io
import itertools
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
FLEETING = (
    "seconds", "images_per_second", "version", "output", "state", "checkpoint", "inputs", "options",
    "record", "report", "rerun",
)  # fmt: skip
# Words, which may change without a change of results.
PROSE = ("convention", "warnings", "reason", "choice", "symmetry_reason", "what", "option")


def commands() -> dict[str, list[str]]:
    """Name -> words of a command; what it writes is named after it."""
    words = {}
    for example in EXAMPLES:
        folder = f"examples/{example}"
        cloud, mask, camera = (
            f"{folder}/initial.ply",
            f"{folder}/mask.png",
            ["--camera", f"{folder}/camera.json"],
        )
        for mode, preset in itertools.product(MODES, PRESETS):
            if (mode, preset) != ("latent", "paper"):
                start = cloud if mode == "points" else f"{folder}/image.png"
                words[f"{example} {mode} {preset}"] = [
                    "refine",
                    "--mode",
                    mode,
                    start,
                    mask,
                    *camera,
                    "--preset",
                    preset,
                ]
        points = ["refine", "--mode", "points"]
        mesh = sorted(Path("examples/meshes", example).glob("*.ply"))[0]
        words[f"{example} two masks"] = [*points, cloud, mask, f"{folder}/second.png"]
        words[f"{example} camera refined"] = [*points, cloud, mask, *camera, "--refine-camera"]
        words[f"{example} no symmetry"] = [*points, cloud, mask, *camera, "--symmetry", "none"]
        words[f"{example} mesh"] = [*points, str(mesh), mask, *camera]
        words[f"{example} check"] = [*points, cloud, mask, *camera, "--check"]
        words[f"{example} eval"] = ["eval", cloud, f"{folder}/target.ply", "--chamfer", "--f-score"]
    chair = ["refine", "--mode", "points", "examples/chair/initial.ply"]
    words["chair in a photo"] = [*chair, "examples/photo/mask.png"]
    words["chair, no camera"] = [*chair, "examples/chair/mask.png", "--camera", "fit"]
    return words


def _second_views(folder: Path) -> None:
    """The first mask of every example again, from a camera that stands elsewhere: a view that the
    first contradicts.
    """
    for example in EXAMPLES:
        scene = folder / "examples" / example
        shutil.copy(scene / "mask.png", scene / "second.png")
        camera = json.loads((scene / "camera.json").read_text())
        camera["R"] = [camera["R"][2], camera["R"][1], [-value for value in camera["R"][0]]]
        (scene / "second.camera.json").write_text(json.dumps(camera))


def pins() -> dict[str, str]:
    """Name -> digest of the cloud and of the JSON document, times aside."""
    digests = {}
    for number, (name, words) in enumerate(commands().items(), 1):
        output = [] if words[0] == "eval" or "--check" in words else ["-o", f"{number}.ply"]
        with (
            contextlib.redirect_stdout(io.StringIO()) as printed,
            contextlib.redirect_stderr(io.StringIO()),
        ):
            try:
                tso([*words, *output, "--json"])
            except SystemExit as stopped:
                assert not stopped.code, f"{' '.join(words)} ended with {stopped.code}"
        content = Path(output[1]).read_bytes() if output else b""
        document = json.dumps(_lasting(json.loads(printed.getvalue())), sort_keys=True)
        digests[name] = hashlib.sha256(content + document.encode()).hexdigest()[:16]
        print(f"\r{number} of {len(commands())}", end="", file=sys.stderr)
    print(file=sys.stderr)
    return digests


def _lasting(value: Any) -> Any:
    if isinstance(value, dict):
        return {
            key: _lasting(entry) for key, entry in value.items() if key not in (*FLEETING, *PROSE)
        }
    return [_lasting(entry) for entry in value] if isinstance(value, list) else value


def main(arguments: list[str]) -> int:
    file = Path(arguments[0]).resolve()
    with tempfile.TemporaryDirectory() as folder:
        working_copy(Path(folder))
        _second_views(Path(folder))
        os.chdir(folder)
        digests = pins()
    if "--check" not in arguments:
        file.write_text(json.dumps(digests, indent=1))
        return 0
    before = json.loads(file.read_text())
    changed = [name for name in sorted(before | digests) if before.get(name) != digests.get(name)]
    print("\n".join(changed) if changed else f"all {len(digests)} as before")
    return 1 if changed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
