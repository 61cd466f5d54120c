"""Every command of docs/files.md runs, and takes the camera that it names."""

import re
import shlex
import shutil

import pytest

from tests.readme import DOCS, ROOT

COMMANDS = re.findall(r"\| `tso (refine [^`]+)` \|", (DOCS / "files.md").read_text())


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("files") / "files"
    shutil.copytree(ROOT / "tests/io/files", folder)
    return folder


def test_the_page_has_a_command_for_every_folder_of_examples():
    named = {word.split("/")[0] for command in COMMANDS for word in shlex.split(command)[1:]}
    folders = {path.name for path in (ROOT / "tests/io/files").iterdir()}
    # The text files of the COLMAP model are read as the binary ones are.
    assert folders - named == {"colmap_text"}


@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_of_the_page_runs(command, files, tso, monkeypatch):
    monkeypatch.chdir(files)
    words = shlex.split(command)
    document = tso(*words, "--check", "--json").document
    camera = words[words.index("--camera") + 1]
    (view,) = document["views"]
    assert ("fitted" if camera == "fit" else camera) in view["camera"]["source"]
    # The cloud is another shape of the type, in the same place.
    assert document["placement"]["box_iou"] > 0.5
