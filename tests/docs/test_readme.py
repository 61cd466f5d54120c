"""The pages say what the program does: every command is run, every table is that of the kept figures."""

from __future__ import annotations

import json
import re
import runpy
import shlex
import sys
from pathlib import Path

import pytest

from tests.readme import (
    FIGURES,
    PAGES,
    README,
    ROOT,
    command_that_remakes,
    console_commands,
    shown_records,
    with_tables,
    working_copy,
)
from tso_cli.cli import main
from tso_cli.lab.studies.fingerprint import differences, study_of

# Records that the method has left behind; a name goes from here when its record is made anew, and none is added.
TO_BE_REMADE: tuple[str, ...] = ()

NUMBER = re.compile(r"-?\d[\d,]*\.?\d*(?:e[+-]?\d+)?")
# Rounding differs between machines. Hundreds of training steps amplify it: what comes of them is compared by its words.
TOLERANCE = 0.05


def _assert_alike(printed: str, shown: str, numbers: bool) -> None:
    """The same words, and with ``numbers`` also numbers alike; times aside."""
    # the width of a column follows its numbers
    plain, expected = (re.sub(r"-{2,}", "--", re.sub(r" +", " ", text)) for text in (printed, shown))
    assert NUMBER.sub("#", plain) == NUMBER.sub("#", expected)
    if not numbers:
        return
    for line, wanted in zip(plain.splitlines(), expected.splitlines(), strict=True):
        if "images/s" in line:
            continue
        timeless = [re.sub(rf"{NUMBER.pattern} s\b|{NUMBER.pattern} views/s", "", text) for text in (line, wanted)]
        found, asked = ([float(n.replace(",", "")) for n in NUMBER.findall(text)] for text in timeless)
        assert found == pytest.approx(asked, rel=TOLERANCE, abs=0.05), line


def test_the_commands_of_the_readme_print_what_the_readme_shows(tmp_path, monkeypatch, capsys):
    """All in one, in their order: one works with the files that another wrote."""
    working_copy(tmp_path)
    monkeypatch.chdir(tmp_path)
    for command, shown in console_commands(README.read_text()):
        words = shlex.split(command)
        assert words[0] == "tso"
        with pytest.raises(SystemExit) as stopped:
            main(words[1:])
        printed = capsys.readouterr()
        assert stopped.value.code == 0, f"{command}: {printed.err}"
        numbers = "base.safetensors" not in command and "car-e" not in command
        _assert_alike(printed.out.rstrip("\n"), shown, numbers)


def test_the_tables_of_the_pages_are_those_of_the_kept_figures():
    for page in PAGES:
        assert page.read_text() == with_tables(page.read_text())
        assert re.search(r"<!-- (points|network|speed machine|accuracy settings|photos|pose) -->", page.read_text())


def test_every_kept_record_is_shown_and_some_page_says_how_to_make_it():
    assert shown_records() == sorted(path.stem for path in FIGURES.glob("*.json"))
    for name in shown_records():
        assert f"{name}.json" in command_that_remakes(name)


def test_what_the_pages_show_was_made_by_the_method_as_it_is():
    """Else the record is to be made again: its command with --overwrite, then `python -m tests.readme --tables`."""
    for name in shown_records():
        record = json.loads((FIGURES / f"{name}.json").read_text())
        found = differences(record) if study_of(record) else ["it does not say its study"]
        if name in TO_BE_REMADE:
            assert found, f"{name} was made anew: it goes from TO_BE_REMADE"
        else:
            told = f"is of another method ({'; '.join(found)}); to be made anew by: {command_that_remakes(name)}"
            assert not found, f"docs/figures/{name}.json {told}"


def test_the_kept_figures_meet_what_the_paper_promises():
    summary = json.loads((FIGURES / "points.json").read_text())["summary"]
    for category, bound in (("chair", 0.95), ("airplane", 0.92), ("car", 0.98)):
        assert summary[category]["ratio_of_means"] <= bound
        assert summary[category]["worst_ratio"] <= 1.02
    for row in json.loads((FIGURES / "examples.json").read_text())["examples"]:
        assert row["chamfer_after"] < row["chamfer_before"]


def test_the_kept_figures_of_the_default_preset_are_of_unseen_shapes_and_hardly_any_got_worse():
    record = json.loads((FIGURES / "accuracy.json").read_text())
    assert (record["complete"], record["settings"]["part"], len(record["settings"]["shapes"])) == (True, "test", 73)
    held = {claim["claim"]: claim["holds"] for claim in record["claims"]}
    for gate in ("points mode, all starts", "airplane near the truth", "every column lies below the paper's preset"):
        assert [holds for claim, holds in held.items() if claim.startswith(gate)] == [True]
    for categories in record["summary"]["other"].values():
        variants = categories["variants"]
        assert variants["best"]["mean_ratio"] < variants["paper"]["mean_ratio"] - 0.1


def test_every_link_of_the_pages_leads_somewhere():
    for page in [README, *ROOT.glob("docs/*.md"), *ROOT.glob("examples/*.md")]:
        for target in re.findall(r"\]\(([^)#]+)\)", page.read_text()):
            if not target.startswith("http"):
                assert (page.parent / target).exists(), f"{page.name}: {target}"


def test_the_script_for_points_runs(capsys):
    runpy.run_path(str(ROOT / "examples" / "refine_points.py"), run_name="__main__")
    before, after = (float(n) for n in re.findall(r"Chamfer x1000 ([\d.]+) -> ([\d.]+)", capsys.readouterr().out)[0])
    assert after < before


def test_the_script_for_networks_runs(tmp_path, monkeypatch, capsys):
    from tso_cli import __version__
    from tso_cli.io.checkpoints import save_network
    from tso_cli.network.model import NetworkConfig, build_network

    checkpoint = tmp_path / "small.safetensors"
    save_network(checkpoint, build_network(points=128), NetworkConfig(points=128, version=__version__))
    monkeypatch.setattr(sys, "argv", ["refine_network.py", str(checkpoint)])
    runpy.run_path(str(ROOT / "examples" / "refine_network.py"), run_name="__main__")
    assert capsys.readouterr().out.count("Chamfer x1000") == 2
    monkeypatch.setattr(sys, "argv", ["refine_network.py"])
    runpy.run_path(str(ROOT / "examples" / "refine_network.py"), run_name="__main__")
    for before, after in re.findall(r"Chamfer x1000 ([\d.]+) -> ([\d.]+)", capsys.readouterr().out):
        assert float(after) < float(before)


def test_the_examples_weigh_under_three_megabytes_and_hold_what_is_promised():
    folder = ROOT / "examples"
    assert sum(path.stat().st_size for path in folder.rglob("*") if path.is_file()) < 3_000_000
    for name in ("chair", "car", "airplane"):
        held = {path.name for path in (folder / name).iterdir()}
        assert {"image.png", "mask.png", "camera.json", "initial.ply", "target.ply"} <= held
    credits = (folder / "CREDITS.md").read_text()
    for mesh in Path(folder / "meshes").rglob("*.ply"):
        assert mesh.name in credits
    assert "GPL" not in credits
    assert "CC-BY" not in credits
