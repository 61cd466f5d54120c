"""`tso refine --prior`: which prior is used, and one line for a file that is none."""

import json

import numpy as np
import pytest

from tests.prior.common import pushing
from tso_cli.io.clouds import read_cloud
from tso_cli.prior import write_prior

POINTS = ("initial.ply", "mask.png", "--overwrite")


@pytest.fixture
def own(folder):
    """A prior that moves everything to the right of the picture."""
    path = folder / "own.safetensors"
    write_prior(path, dict(pushing(0.05, 0.0, 0.0).weights), {"training_set": "none"}, False)
    return path


def test_the_shipped_prior_is_used_unless_another_or_none_is_asked_for(folder, refine, own):
    results = {}
    for name in ("learned", "none", "own.safetensors"):
        document = refine(*POINTS, "--prior", name, "--steps", "6", "--json").document
        assert document["prior"] == name
        results[name] = read_cloud(folder / "initial.refined.ply").points
        assert (document["moved_by_prior"] > 0.001) == (name == "learned")
    plain = refine(*POINTS, "--steps", "6", "--json").document
    assert plain["prior"] == "learned"
    assert plain["losses"] == refine(*POINTS, "--steps", "6", "--json").document["losses"]
    assert np.abs(results["learned"] - results["none"]).max() > 0.01


def test_a_prior_of_ones_own_moves_the_cloud_where_the_mask_agrees(folder, refine, own):
    """The mask is that of the start, moved to the right by the start's own displacement."""
    cloud = read_cloud(folder / "initial.ply").points
    camera = json.loads((folder / "camera.json").read_text())
    right = np.array(camera["R"])[0] * np.ptp(cloud, axis=0).max() * 0.05
    np.save(folder / "left.npy", cloud - right)
    document = refine(
        "left.npy", "mask.png", "--overwrite", "--prior", own, "--steps", "1", "--json"
    ).document
    assert document["prior"].endswith("own.safetensors")
    assert str(own) in [str(path) for path in document["inputs"]]


@pytest.mark.parametrize(
    ("file", "says"),
    [
        ("missing.safetensors", "missing.safetensors: does not exist, expected a learned prior"),
        (".", ": is a folder, expected a learned prior"),
        ("mask.png", "mask.png: is damaged or of another kind"),
        ("half.safetensors", "half.safetensors: is damaged or of another kind"),
        ("nan.safetensors", "nan.safetensors: tensor view1 holds NaN or infinite"),
        (
            "short.safetensors",
            "short.safetensors: tensor view1 is float16 of shape [3], expected float16",
        ),
        ("less.safetensors", "less.safetensors: has no tensor view1, expected shape ["),
        ("network.safetensors", "network.safetensors: the format in its metadata is"),
    ],
)
def test_what_is_no_prior_is_refused_in_one_line(folder, refine, own, file, says):
    from safetensors.numpy import load, save_file

    data = own.read_bytes()
    (folder / "half.safetensors").write_bytes(data[: len(data) // 2])
    tensors, about = load(data), {"tso": json.dumps({"format": "tso-prior-2"})}
    bad = tensors["view1"].copy()
    bad[0, 0] = np.nan
    for name, changed in (("nan", {"view1": bad}), ("short", {"view1": bad[1, :3].copy()})):
        save_file({**tensors, **changed}, folder / f"{name}.safetensors", about)
    less = {name: array for name, array in tensors.items() if name != "view1"}
    save_file(less, folder / "less.safetensors", about)
    other = {"tso": json.dumps({"format": "tso-network-1"})}
    save_file(tensors, folder / "network.safetensors", other)
    assert says in refine("initial.ply", "mask.png", "--prior", file).refusal
    assert not (folder / "initial.refined.ply").exists()


@pytest.mark.parametrize(
    "options", [("--preset", "paper"), ("--mode", "encoder")], ids=["paper", "encoder"]
)
def test_the_paper_and_the_network_modes_use_no_prior(folder, refine, options):
    photo = "image.png" if "encoder" in options else "initial.ply"
    asked = refine(photo, "mask.png", *options, "--prior", "learned")
    assert asked.refusal.startswith(
        "tso: error: --prior learned is for --mode points and --preset best"
    )
    document = refine(photo, "mask.png", *options, "--steps", "1", "--json").document
    assert document["prior"] == "none"
    assert document["moved_by_prior"] == 0.0


def test_a_record_names_its_prior_and_runs_again(folder, refine, own):
    first = refine(*POINTS, "--prior", own, "--record", "--steps", "3", "--json").document
    record = json.loads((folder / "initial.refined.record.json").read_text())
    assert record["options"]["prior"] == "own.safetensors"
    assert "own.safetensors" in record["inputs"]
    config = ("--config", "initial.refined.record.json")
    again = refine("initial.ply", "mask.png", "--overwrite", *config, "--json").document
    assert again["losses"] == first["losses"]
    refine(*POINTS, "--prior", "none", "--record", "--steps", "3")
    record = json.loads((folder / "initial.refined.record.json").read_text())
    assert record["options"]["prior"] == "none"
    again = refine("initial.ply", "mask.png", "--overwrite", *config, "--json").document
    assert again["prior"] == "none"


def test_a_file_whose_name_is_a_word_is_meant_with_its_folder(folder, refine, own):
    own.rename(folder / "none")
    assert (
        refine(*POINTS, "--prior", "./none", "--steps", "1", "--json").document["prior"] != "none"
    )


def test_a_check_looks_at_the_prior_too(folder, refine):
    asked = refine("initial.ply", "mask.png", "--check", "--prior", "nothere.safetensors")
    assert asked.code == 2
    assert "nothere.safetensors: does not exist, expected a learned prior" in asked.err


def test_another_prior_is_another_key(folder, refine):
    """A batch that goes on with another prior does its items again."""
    keys = set()
    for options in ((), ("--prior", "none"), ("--prior", "learned")):
        refine(*POINTS, *options, "--record", "--steps", "1")
        keys.add(json.loads((folder / "initial.refined.record.json").read_text())["key"])
    assert len(keys) == 3
