"""Output files are written whole or not at all."""

import errno
import os
import subprocess
import sys

import numpy as np
import pytest

from tests.corruption import assert_refused
from tso_cli.errors import InputError
from tso_cli.geometry.camera import Camera
from tso_cli.io.cameras import CameraRecord, write_cameras
from tso_cli.io.checkpoints import save_network
from tso_cli.io.clouds import write_cloud
from tso_cli.io.images import write_image
from tso_cli.io.meshes import Mesh, write_mesh
from tso_cli.io.output import atomic_output, check_output, reason
from tso_cli.network.model import NetworkConfig, build_network

WRITERS = {
    "cloud.ply": lambda path, **options: write_cloud(path, np.eye(3), **options),
    "mesh.ply": lambda path, **options: write_mesh(
        path, Mesh(np.eye(3), np.array([[0, 1, 2]])), **options
    ),
    "picture.png": lambda path, **options: write_image(path, np.eye(8, dtype=np.uint8), **options),
    "camera.json": lambda path, **options: write_cameras(
        path, [CameraRecord(Camera.canonical(8, 8))], **options
    ),
    "network.safetensors": lambda path, **options: save_network(
        path, build_network(4), NetworkConfig(points=4), **options
    ),
}


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("nowhere/new.ply", r"nowhere.new\.ply: the folder .*nowhere does not exist"),
        ("", "is a folder"),
        ("old.ply/new.ply", "old.ply is not a folder"),
        ("/dev/null", "not a regular file"),
    ],
)
def test_what_cannot_be_an_output_is_refused(tmp_path, name, message):
    (tmp_path / "old.ply").touch()
    assert_refused(message, check_output, tmp_path / name, overwrite=True)


@pytest.mark.usefixtures("tiny_network")
@pytest.mark.parametrize("name", WRITERS)
def test_an_existing_file_is_not_replaced_unasked(tmp_path, name):
    path = tmp_path / name
    path.write_text("old")
    assert_refused(f"{name}: exists already.*`overwrite`", WRITERS[name], path)
    assert path.read_text() == "old"
    WRITERS[name](path, overwrite=True)
    assert path.read_bytes() != b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_name_that_cannot_be_is_refused_in_one_line(tmp_path):
    for name in ("a" * 5000, "nul\0byte"):
        with pytest.raises(InputError, match="cannot be written"):
            check_output(tmp_path / name, overwrite=False)
        with pytest.raises(InputError, match="cannot be written"), atomic_output(tmp_path / name):
            pass


def test_the_file_appears_only_when_it_is_complete(tmp_path):
    path = tmp_path / "out.npy"
    with atomic_output(path) as temporary:
        assert temporary.suffix == ".npy"
        assert temporary.parent == tmp_path
        temporary.write_bytes(b"half")
        assert not path.exists()
    assert path.read_bytes() == b"half"
    assert list(tmp_path.iterdir()) == [path]
    (tmp_path / "plain").touch()
    assert path.stat().st_mode == (tmp_path / "plain").stat().st_mode


FULL = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), "temporary")


@pytest.mark.parametrize("error", [RuntimeError("bug"), KeyboardInterrupt(), FULL])
def test_a_failure_leaves_the_old_file_and_nothing_else(tmp_path, error):
    path = tmp_path / "out.txt"
    path.write_text("old")
    message = (
        r"out\.txt: cannot be written \(No space left on device\), nothing was kept$"
        if error is FULL
        else None
    )
    with (
        pytest.raises(InputError if error is FULL else type(error), match=message),
        atomic_output(path) as temporary,
    ):
        temporary.write_text("new")
        raise error
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_real_limit_on_file_size_leaves_nothing_behind(tmp_path):
    program = (
        "import resource, sys, numpy as np\n"
        "from tso_cli.io.clouds import write_cloud\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (10000, 10000))\n"
        "try:\n"
        "    write_cloud(sys.argv[1], np.random.default_rng(0).random((5000, 3)))\n"
        "except Exception as error:\n"
        "    print(type(error).__name__, error)\n"
    )
    run = subprocess.run(
        [sys.executable, "-c", program, str(tmp_path / "big.ply")], capture_output=True, text=True
    )
    assert run.stdout.startswith("InputError"), run.stderr
    assert "big.ply: cannot be written (File too large)" in run.stdout
    assert list(tmp_path.iterdir()) == []


def test_a_symbolic_link_stays_and_a_reader_of_the_old_file_keeps_it(tmp_path):
    """The new file takes the name that the link points to; nothing is written into the old one."""
    (tmp_path / "store").mkdir()
    real, link = tmp_path / "store" / "real.txt", tmp_path / "link.txt"
    real.write_text("old")
    link.symlink_to(real)
    with real.open() as reader:
        with atomic_output(link) as temporary:
            temporary.write_text("new")
        assert reader.read() == "old"
    assert link.is_symlink()
    assert real.read_text() == "new"


def test_what_a_library_says_becomes_one_printable_line():
    assert (
        reason(ValueError('format of "\x1b[2J,\x07" is\n  unknown'))
        == 'format of "\\x1b[2J,\\x07" is unknown'
    )
    assert reason(KeyError()) == "KeyError"
    assert len(reason(ValueError("x" * 1000))) == 200


def test_a_link_that_leads_nowhere_is_not_followed_without_overwrite(tmp_path):
    link = tmp_path / "a.txt"
    link.symlink_to(tmp_path / "elsewhere.txt")
    assert_refused("exists already", check_output, link, False)
    with pytest.raises(InputError, match="exists already"), atomic_output(link, overwrite=False):
        pass
    assert list(tmp_path.iterdir()) == [link]
