"""What a command does not use it does not import."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

import tso_cli
from tso_cli.io.shipped import examples_folder
from tso_cli.refinement import PRESETS

# Each takes 0.1 s or more to import with what it imports itself; a whole command takes about 1 s.
HEAVY = ("torch", "scipy", "matplotlib", "skimage", "trimesh", "open3d", "sympy", "numpy.f2py")
CHAIR = examples_folder() / "chair"


def _imported(folder, *command_lines):
    """Names of all modules that one process has imported after these command lines."""
    code = "import sys\nfrom tso_cli.cli import main\n"
    for line in command_lines:
        code += f"try:\n    main({line.split()!r})\n"
        code += "except SystemExit as end:\n    assert end.code == 0\n"
    code += "print('', *sys.modules, file=sys.stderr, sep='\\n')"
    environment = os.environ | {"PYTHONPATH": str(Path(tso_cli.__file__).parents[1])}
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, cwd=folder, env=environment
    )
    assert done.returncode == 0, done.stderr
    return set(done.stderr.splitlines())


@pytest.mark.parametrize("preset", PRESETS)
def test_refining_points_imports_nothing_heavy(tmp_path, preset):
    options = f"--steps 6 --overlay chair.png --preset {preset}"
    modules = _imported(tmp_path, f"refine {CHAIR / 'initial.ply'} {CHAIR / 'mask.png'} {options}")
    assert {"tso_cli.refinement.api", "PIL.Image"} <= modules
    assert "tso_cli.plots.page" not in modules
    assert not modules & set(HEAVY)


def test_refining_a_mesh_imports_nothing_heavy(tmp_path):
    """So that judging the result takes a tenth of the run, and not a third."""
    mesh = examples_folder() / "meshes" / "chair" / "q17_Chair.ply"
    camera = CHAIR / "camera.json"
    modules = _imported(
        tmp_path, f"refine {mesh} {CHAIR / 'mask.png'} --camera {camera} -o out.ply"
    )
    assert not modules & set(HEAVY)


def test_reading_and_writing_from_python_imports_nothing_heavy(tmp_path):
    code = "import sys, tso_cli; before = {*sys.modules}; tso_cli.read_mask, tso_cli.draw_overlay\n"
    code += "print('numpy' in before, *sys.modules, sep='\\n')"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path, check=True
    )
    numpy_before, *modules = done.stdout.splitlines()
    assert numpy_before == "False"
    assert "tso_cli.files" in modules
    assert not set(modules) & set(HEAVY)


def test_version_and_help_import_no_numbers(tmp_path):
    modules = _imported(tmp_path, "--version", "--help")
    assert "tso_cli.cli" in modules
    assert not modules & {"numpy", "PIL", *HEAVY}


def test_the_help_of_a_command_imports_no_torch(tmp_path):
    commands = ("refine", "eval", "train", "curves", "export", "render", "lab")
    assert not _imported(tmp_path, *(f"{command} --help" for command in commands)) & set(HEAVY)


NO_TORCH = (
    "tso: error: networks need torch, which is not installed: pip install 'tso-cli[network]'\n"
)


@pytest.mark.parametrize(
    ("line", "code", "error"),
    [
        (f"refine {CHAIR / 'image.png'} {CHAIR / 'mask.png'} --mode encoder", 1, NO_TORCH),
        ("train shapes -o net.safetensors", 1, NO_TORCH),
        ("refine no.ply no.png", 2, "tso: error: no.ply: does not exist, expected a point cloud\n"),
    ],
)
def test_without_torch_an_error_is_one_line_and_a_command_that_needs_it_says_so(
    tmp_path, line, code, error
):
    script = "import sys; sys.modules['torch'] = None\nfrom tso_cli.cli import main\n"
    script += f"main({line.split()!r})"
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, cwd=tmp_path
    )
    assert done.returncode == code
    assert done.stderr == error
