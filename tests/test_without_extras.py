"""What a plain installation can do, and what it says where an extra is missing."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import tso_cli
from tso_cli.errors import EXTRAS
from tso_cli.io.shipped import examples_folder

ROOT = Path(tso_cli.__file__).parents[1]
CHAIR, CAR = (examples_folder() / name for name in ("chair", "car"))
FILES = Path(__file__).parent / "io/files"
# Python imports this module when it starts, so that the processes of a batch have it too.
SITE = f"""
import sys

class Missing:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {tuple(EXTRAS)!r}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)

sys.meta_path.insert(0, Missing())
"""


@pytest.fixture
def plain(tmp_path, monkeypatch):
    """Runs Python in ``tmp_path`` as if no extra was installed."""
    (tmp_path / "site").mkdir()
    (tmp_path / "site/sitecustomize.py").write_text(SITE)
    paths = os.pathsep.join((str(tmp_path / "site"), str(ROOT)))
    environment = os.environ | {"PYTHONPATH": paths}

    def run(*words):
        return subprocess.run(
            [sys.executable, *map(str, words)],
            capture_output=True,
            text=True,
            cwd=tmp_path,
            env=environment,
        )

    return run


def test_points_mode_batches_and_measures_need_no_extra(plain, tmp_path):
    cloud, mask, target = (CHAIR / name for name in ("initial.ply", "mask.png", "target.ply"))
    (tmp_path / "items.csv").write_text(f"cloud,mask\n{cloud},{mask}\n")
    lines = [
        f"refine {cloud} {mask} --steps 6 -o a.ply --report a.html --overlay a.png",
        f"refine {cloud} {mask} --check",
        f"eval --chamfer --f-score a.ply {target}",
        f"eval --iou a.ply {target} --mask {mask}",
        "convert a.ply a.npy",
        f"mask {mask}",
        "batch items.csv -o out",
        "doctor",
        *(f"{name} --help" for name in ("render", "train", "curves", "export", "lab")),
    ]
    script = "import sys\nfrom tso_cli.cli import main\nif __name__ == '__main__':\n"
    script += f" for line in {[line.split() for line in lines]!r}:\n"
    script += "  try:\n   main(line)\n  except SystemExit as end:\n"
    script += "   assert end.code == 0, line\n"
    (tmp_path / "script.py").write_text(script)
    done = plain("script.py")
    assert done.returncode == 0, done.stderr
    assert all((tmp_path / f"a.{suffix}").exists() for suffix in ("ply", "html", "png", "npy"))
    assert (tmp_path / "out/initial.refined.ply").exists()


NETWORK = "networks need torch, which is not installed: pip install 'tso-cli[network]'"


@pytest.mark.parametrize(
    ("line", "code", "said"),
    [
        (f"refine {CAR / 'image.png'} {CAR / 'mask.png'} --mode encoder", 1, NETWORK),
        ("train -o net.safetensors", 1, NETWORK),
        ("export net.safetensors -o small.safetensors", 1, NETWORK),
        (
            "convert cloud.pt cloud.ply",
            2,
            "cloud.pt: tensors need torch, which is not installed: pip install 'tso-cli[network]'",
        ),
        (
            "curves log.jsonl -o curves.png",
            1,
            "charts need matplotlib, which is not installed: pip install 'tso-cli[plots]'",
        ),
        (
            "batch items.csv -o out --engine dask",
            2,
            "--engine dask needs dask, which is not installed: pip install 'tso-cli[dask]'",
        ),
    ],
    ids=lambda value: value.split()[0] if isinstance(value, str) else "",
)
def test_a_missing_extra_is_one_line_with_its_command(plain, tmp_path, line, code, said):
    torch = pytest.importorskip("torch")
    torch.save({"points": torch.from_numpy(np.eye(3))}, tmp_path / "cloud.pt")
    log = '{"supervision": "points"}\n{"step": 1, "loss": 2.0}\n{"step": 2, "loss": 1.0}\n'
    (tmp_path / "log.jsonl").write_text(log)
    (tmp_path / "rle.json").write_bytes((FILES / "masks/rle.json").read_bytes())
    (tmp_path / "items.csv").write_text(
        f"cloud,mask\n{CHAIR / 'initial.ply'},{CHAIR / 'mask.png'}\n"
    )
    done = plain("-m", "tso_cli", *line.split())
    assert done.returncode == code
    # A batch may say before that it compiles the loops.
    assert done.stderr.splitlines()[-1] == f"tso: error: {said}"
    assert "Traceback" not in done.stderr


def test_a_public_name_that_needs_an_extra_says_so_and_no_other_needs_one(plain):
    script = """
import tso_cli
for name in tso_cli.__all__:
    try:
        getattr(tso_cli, name)
    except ImportError as error:
        print(type(error).__name__, error.name, error)
"""
    done = plain("-c", script)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout == (
        "ModuleNotFoundError torch MaskLoss needs torch, which is not installed: "
        "pip install 'tso-cli[network]'\n"
    )


def test_rendering_without_open3d_names_its_extra(plain):
    done = plain("-m", "tso_cli", "render", examples_folder() / "meshes/car", "-o", "out")
    assert done.returncode == 1
    assert "pip install 'tso-cli[render]'" in done.stderr
    assert len(done.stderr.splitlines()) == 1
