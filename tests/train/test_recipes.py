"""Recipes: `tso train --config`, and what the shipped recipes say."""

from pathlib import Path

import pytest

from tso_cli.io.checkpoints import load_network
from tso_cli.io.shipped import PACKAGE
from tso_cli.prior.file import read_prior

RENDERED = """
[render]
views = 2
size = "24"
samples = 200
points = 50
family = ["chair=2", "car=1"]
"""
NETWORK = 'steps = 2\nbatch-size = 2\npoints = 64\ndecay = "cosine"\n' + RENDERED
PRIOR = "by-rule = 2\nscenes = 3\nsteps = 2\nbatch-size = 2\n"


@pytest.fixture(autouse=True)
def alone(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def recipe():
    def write(text, name="recipe.toml"):
        Path(name).write_text(text)
        return name

    return write


def test_a_recipe_renders_shapes_by_rule_and_trains_on_them(tso, recipe):
    pytest.importorskip("open3d")
    done = tso("train", "--config", recipe(NETWORK), "-o", "net.safetensors")
    assert done.code == 0, done.err
    assert sorted(path.parent.name for path in Path("net.rendered").rglob("target.ply")) == [
        "rule-00001", "rule-00001", "rule-00002",
    ]  # fmt: skip
    _, about = load_network(Path("net.safetensors"))
    assert about.settings["recipe"].startswith("recipe.toml ")
    assert about.settings["decay"] == "cosine"
    assert about.steps == 2


def test_the_command_line_is_stronger_than_the_recipe(tso, recipe):
    pytest.importorskip("open3d")
    done = tso("train", "--config", recipe(NETWORK), "--steps", 3, "-o", "net.safetensors")
    assert done.code == 0, done.err
    assert load_network(Path("net.safetensors"))[1].steps == 3


def test_a_recipe_trains_a_prior_on_shapes_by_rule_alone_and_the_same_bytes_again(tso, recipe):
    pytest.importorskip("open3d")
    name = recipe(PRIOR)
    for output, more in (("a.safetensors", ()), ("b.safetensors", ("--workers", 2))):
        done = tso("train-prior", "--config", name, *more, "-o", output)
        assert done.code == 0, done.err
    assert Path("a.safetensors").read_bytes() == Path("b.safetensors").read_bytes()
    about = read_prior(Path("a.safetensors"))[1]
    assert about["training_set"] == "2 shapes of each family"
    assert about["settings"]["recipe"].startswith("recipe.toml ")


def test_a_recipe_with_the_same_settings_resumes_a_training_and_another_does_not(tso, recipe):
    pytest.importorskip("open3d")
    assert tso("train-prior", "--config", recipe(PRIOR), "-o", "a.safetensors").code == 0
    resumed = "--resume", "-o", "a.safetensors"
    assert tso("train-prior", "--config", recipe(PRIOR + "# as it was\n"), *resumed).code == 0
    other = recipe(PRIOR + "marred = 0.5\n", "other.toml")
    refused = tso("train-prior", "--config", other, *resumed).refusal
    assert "was trained with --marred 0.4, this run asks for 0.5" in refused


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("step = 3", "'step' is no option of train, expected names such as seed or output"),
        ("steps = true", "steps is True, expected a whole number, 1 or more"),
        ("render = 3", "render is 3, expected a table of options"),
        (
            "[render]\nviews = 0\nfamily = ['car=1']",
            "views is 0, expected a whole",
        ),
        ("[other]\nviews = 1", "'other' is a table, expected options"),
        ("steps = ", "cannot be read"),
    ],
)
def test_a_wrong_recipe_is_refused_in_one_line(tso, recipe, text, message):
    refused = tso("train", "--config", recipe(text)).refusal
    assert message in refused, refused


def test_a_recipe_that_is_not_there_is_refused(tso):
    assert "none.toml: " in tso("train", "--config", "none.toml").refusal


@pytest.mark.parametrize(("name", "command"), [("network", "train"), ("prior", "train-prior")])
def test_the_shipped_recipes_can_be_read_and_name_a_split_that_is_there(tso, name, command):
    assert (PACKAGE / "recipes" / f"{name}.toml").is_file()
    # Without the meshes: everything else has been read by then.
    refused = tso(command, "nowhere", "--config", name, "-o", "x.safetensors").refusal
    assert refused.startswith("tso: error: nowhere: "), refused


def test_the_rate_of_a_cosine_falls_to_nothing():
    from tso_cli.train.config import TrainConfig

    config = TrainConfig(steps=100, learning_rate=0.5, decay="cosine")
    assert [config.rate(step) for step in (0, 50, 100)] == pytest.approx([0.5, 0.25, 0.0])
    assert TrainConfig(learning_rate=0.5).rate(70) == 0.5
