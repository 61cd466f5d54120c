"""Files of `--config`: what is wrong in one, and what has changed since a record was written."""

import json
import shutil
from pathlib import Path

import pytest

from tests.corruption import assert_one_line, corruptions
from tso_cli import __version__
from tso_cli.io.clouds import read_cloud, write_cloud

FEW = ("--move", "shape")  # a quick run


@pytest.fixture
def record(folder, tso):
    """The record of a run of the chair, in a folder of its own."""
    Path("in").mkdir()
    done = tso("refine", "initial.ply", "mask.png", *FEW, "--record", "-q", "-o", "in/first.ply")
    assert done.code == 0
    return Path("in/first.record.json")


@pytest.fixture
def repeated(tso, record):
    """The warnings of another run with that record, whatever else is given."""

    def run(*more):
        done = tso("refine", "--config", record, "--overwrite", *more)
        assert done.code == 0, done.err
        return [line.removeprefix("tso: warning: ") for line in done.err.splitlines()]

    return run


def moved():
    """Another cloud than the one of the record."""
    cloud = read_cloud(Path("initial.ply"))
    write_cloud("initial.ply", cloud.points + 0.01, like=cloud, overwrite=True)


def test_a_record_names_inputs_from_its_own_folder_and_is_repeated_without_a_warning(
    repeated, record, monkeypatch
):
    inputs = json.loads(record.read_text())["inputs"]
    assert set(inputs) == {"../initial.ply", "../mask.png", "../camera.json"}
    assert repeated() == []


def test_a_record_behind_a_link_is_repeated_too(record, tso):
    """From a folder behind a link, .. leads elsewhere than its name says."""
    Path("disk/big/results").mkdir(parents=True)
    Path("link").symlink_to("disk/big/results")
    first = tso("refine", "--config", record, "--record", "-o", "link/first.ply")
    again = tso("refine", "--config", "link/first.record.json", "-o", "again.ply")
    assert (first.code, again.code, again.err) == (0, 0, "")


@pytest.mark.parametrize("name", ["o.json", "o.toml"])
def test_an_option_that_a_file_has_twice_is_refused(folder, tso, name):
    text = '{"steps": 1, "steps": 2}' if name == "o.json" else 'steps = 1\n"--steps" = 2\n'
    Path(name).write_text(text)
    refused = tso("refine", "initial.ply", "mask.png", "--config", name)
    assert refused.code == 2
    assert "steps is there twice" in refused.err


def test_a_file_of_options_is_not_overwritten(folder, tso):
    Path("o.json").write_text('{"steps": 1}')
    arguments = ("--config", "o.json", "--write-camera", "o.json", "--overwrite")
    refused = tso("refine", "initial.ply", "mask.png", *arguments)
    assert refused.code == 2
    assert "is the file of --config" in refused.err
    assert Path("o.json").read_text() == '{"steps": 1}'


def test_an_input_that_has_changed_since_the_record_is_named(repeated, record):
    moved()
    assert repeated() == [f"initial.ply: has changed since {record}, so the result may differ"]


def test_an_input_that_the_command_line_replaces_is_not_compared(repeated, record):
    shutil.copy("initial.ply", "other.ply")
    moved()
    assert repeated("other.ply") == []
    Path("mask.png").write_bytes(Path("mask.png").read_bytes() + b"0")
    changed = f"mask.png: has changed since {record}, so the result may differ"
    assert repeated("other.ply") == [changed]


def test_a_camera_file_that_is_gone_or_new_is_named(repeated, record):
    Path("camera.json").rename("mask.camera.json")
    assert repeated() == []  # the same camera by another name
    Path("mask.camera.json").write_text(Path("mask.camera.json").read_text() + "\n")
    assert repeated() == [
        f"mask.camera.json: is no input of {record}, so the result may differ",
        f"camera.json: is not read now, but is an input of {record}, so the result may differ",
    ]


def test_a_record_of_another_version_is_named(repeated, record):
    document = json.loads(record.read_text())
    record.write_text(json.dumps({**document, "version": "9.9"}))
    assert repeated() == [f"{record}: is of tso 9.9, this is {__version__}; defaults may differ"]
    assert repeated("--quiet") == []


@pytest.mark.parametrize(
    ("option", "value", "expected"),
    [
        ("source", None, "None, expected a path"),
        ("source", 3, "3, expected a path"),
        ("source", "a\0b", "'a\\x00b', expected a path"),
        ("masks", ["mask.png", None], "None, expected a path"),
        ("masks", "\ud800.png", "'\\ud800.png', expected a path"),
        ("steps", "x", "'x', expected a whole number, 0 or more"),
        ("steps", 2.5, "2.5, expected a whole number, 0 or more"),
        ("steps", -1, "-1, expected a whole number, 0 or more"),
        ("steps", True, "True, expected a whole number, 0 or more"),
        ("points", "many", "'many', expected auto or a whole number from 16 to 16,384"),
        ("gamma", [1], "[1], expected a number from 0 to 1e+15"),
        ("gamma", 10**400, f"1{'0' * 56}..., expected a number from 0 to 1e+15"),
        ("preset", 1, "1, expected one of best, paper"),
        ("preset", "worst", "'worst', expected one of best, paper"),
        ("invert_mask", "maybe", "'maybe', expected true or false"),
        ("symmetry", False, "False, expected text"),
    ],
    ids=lambda value: repr(value)[:20],
)
def test_a_value_of_another_kind_is_refused_with_its_file_and_key(
    tso, folder, option, value, expected
):
    Path("o.json").write_text(json.dumps({option: value}))
    refusal = tso("refine", "initial.ply", "mask.png", "--config", "o.json").refusal
    assert refusal == f"tso: error: o.json: {option} is {expected}"


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("inputs", None, "inputs is None, expected a record of --record"),
        ("version", 1, "version is 1, expected a record of --record"),
        ("options", [], "options is [], expected a record of --record"),
        ("options", {"source": None}, "source is None, expected a path"),
    ],
)
def test_a_damaged_record_is_refused(tso, record, key, value, message):
    document = json.loads(record.read_text())
    record.write_text(json.dumps({**document, key: value}))
    assert tso("refine", "--config", record).refusal == f"tso: error: {record}: {message}"


@pytest.mark.parametrize("text", ["[refine]\nsteps = 2\n", "camera.file = 'camera.json'\n"])
def test_a_table_in_a_file_of_options_is_refused_as_one(tso, folder, text):
    Path("o.toml").write_text(text)
    name = "refine" if "refine" in text else "camera"
    assert tso("refine", "initial.ply", "mask.png", "--config", "o.toml").refusal == (
        f"tso: error: o.toml: '{name}' is a table, expected options such as steps = 20 at the top "
        "of the file"
    )


def test_one_mask_needs_no_list_in_a_file_of_options(tso, folder):
    Path("o.toml").write_text('cloud = "initial.ply"\nmask = "mask.png"\nsteps = 5\n')
    assert tso("refine", "--config", "o.toml", "--check", "-q").code == 0


def test_a_record_with_random_damage_is_read_or_refused_in_one_line(tso, record):
    """With --check: what is read is not refined."""
    whole = json.loads(record.read_text())
    parts = {name: whole[name] for name in ("schema", "version", "inputs", "options")}
    good = json.dumps(parts).encode()
    for data in corruptions(good, 150):
        record.write_bytes(data)
        done = tso("refine", "initial.ply", "mask.png", "--config", record, "--check", "-q")
        assert done.code in (0, 1, 2), done.err
        for line in done.err.splitlines():
            assert line.startswith(("tso: error: ", "tso: warning: "))
            assert_one_line(line)
