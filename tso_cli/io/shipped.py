"""Where to find the examples and the network that come with the program."""

from __future__ import annotations

from pathlib import Path

from ..errors import InputError

CATEGORIES = ("chair", "car", "airplane")
DEFAULT = "default"  # name of the network that comes with the program, as in `--checkpoint default`
# Words that stand in place of the file of a learned prior: the one that comes with the program, and
# that none is used.
LEARNED, NO_PRIOR = "learned", "none"
PACKAGE = Path(__file__).resolve().parent.parent
WEIGHTS = PACKAGE / "weights"
DEFAULT_PRIOR = WEIGHTS / "prior.safetensors"


def examples_folder() -> Path:
    """The folder ``examples``: inside the installed package, or next to the package in a clone."""
    for folder in (PACKAGE / "examples", PACKAGE.parent / "examples"):
        if (folder / "meshes").is_dir():
            return folder
    raise InputError(
        f"{PACKAGE.parent / 'examples'}: the shipped examples are not here, "
        "expected a clone of the repository (or give a folder of your own)"
    )


def example_meshes() -> list[Path]:
    """The shipped meshes to train on, sorted by category and name.

    The shapes that the examples should be refined to are not among them.
    """
    folder = examples_folder() / "meshes"
    meshes = [path for category in CATEGORIES for path in sorted((folder / category).glob("*.ply"))]
    if not meshes:
        raise InputError(f"{folder}: no mesh, expected {', '.join(CATEGORIES)} with .ply files")
    return meshes


def default_checkpoint() -> Path:
    """The network that comes with the program; InputError if the installation lacks it."""
    path = WEIGHTS / "default.safetensors"
    if not path.is_file():
        raise InputError(
            f"{path}: the shipped network is not in this installation, expected it there "
            "(or give `checkpoint` FILE; tso train writes one)"
        )
    return path


def named_checkpoint(name: Path) -> Path:
    """The shipped network if ``name`` is DEFAULT, otherwise the file ``name``.

    A file that is called DEFAULT can be given by its absolute path.
    """
    return default_checkpoint() if str(name) == DEFAULT else name
