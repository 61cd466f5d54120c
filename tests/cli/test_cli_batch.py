"""`tso batch`: items end once whatever is killed; `--record` and `--config` repeat a run."""

import contextlib
import errno
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import tso_cli
from tests.corruption import assert_refused
from tests.scenes import EXAMPLES
from tso_cli.batch.engines import engine
from tso_cli.batch.journal import ENDS, entries
from tso_cli.batch.manifest import Item, read_manifest
from tso_cli.commands.batch.command import command as batch_command
from tso_cli.commands.batch.item import written_by
from tso_cli.commands.batch.items import OF_BATCH, options_of_items
from tso_cli.commands.refine.record import key_of
from tso_cli.errors import InputError
from tso_cli.io.clouds import read_cloud, write_cloud
from tso_cli.io.masks import read_mask
from tso_lab.bench.scale import conclude, long_batch, processes_of, write_poison
from tso_lab.study import Progress

ROOT = Path(__file__).parents[2]
PACKAGE = Path(tso_cli.__file__).parent
CHAIR, CAR = EXAMPLES / "chair", EXAMPLES / "car"
linux = pytest.mark.skipif(sys.platform != "linux", reason="kills processes by /proc")


@pytest.fixture
def items(tmp_path, monkeypatch):
    """Write items.csv with these rows in the working directory."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("OMP_NUM_THREADS", "2")

    def write(header, *rows):
        Path("items.csv").write_text("\n".join([header, *rows]) + "\n")

    return write


def row(name, cloud=CHAIR / "initial.ply", more="2,best"):
    return f"{cloud},{CHAIR / 'mask.png'},{name},{more}"


HEADER = "cloud,mask,output,steps,preset"


def ends_of(journal):
    """Item -> its ends."""
    found = {}
    for entry in entries(Path(journal)):
        if entry["event"] in ENDS:
            found.setdefault(entry["item"], []).append(entry["event"])
    return found


def test_every_item_is_refined_as_it_is_alone(items, tso):
    items(HEADER, row("a.ply"), f"{CAR / 'initial.ply'},{CAR / 'mask.png'},in/b.ply,3,best")
    found = tso("batch", "items.csv", "-o", "out", "--json").document
    assert found["done"] == 2
    alone = ("--steps", 3, "-o", "b.ply")
    assert tso("refine", CAR / "initial.ply", CAR / "mask.png", *alone).code == 0
    results = [read_cloud(path).points for path in ("out/in/b.ply", "b.ply")]
    np.testing.assert_allclose(*results, atol=1e-5)
    assert ends_of("out/journal.jsonl") == {"a.ply": ["done"], "in/b.ply": ["done"]}


def test_an_array_of_clouds_is_an_item_for_each_with_its_own_mask(items, tso):
    clouds = [read_cloud(folder / "initial.ply").points[:1000] for folder in (CHAIR, CAR)]
    masks = [folder / "mask.png" for folder in (CHAIR, CAR)]
    np.save("clouds.npy", np.stack(clouds))
    np.save("masks.npy", np.stack([read_mask(mask) for mask in masks]))
    shutil.copy(CHAIR / "camera.json", "camera.json")
    items("cloud,mask,camera,output,steps", f"clouds.npy,{masks[0]};{masks[1]},,two/a.ply,2",
          "clouds.npy,masks.npy,camera.json,b.ply,2", f"clouds.npy,{masks[0]},,one.ply,2",
          f"clouds.npy,{masks[1]},,,2", "nothing.npy,masks.npy,,,2")  # fmt: skip
    rows = list(options_of_items(read_manifest(Path("items.csv")), "", Path("out"), False))
    assert [name for name, _ in rows] == [
        "two/a_0.ply", "two/a_1.ply", "b_0.ply", "b_1.ply", "one_0.ply", "one_1.ply",
        "clouds_0.refined.ply", "clouds_1.refined.ply", "nothing.refined.ply",
    ]  # fmt: skip
    of_rows = [(row.get("cloud_index"), row.get("mask_index"), row["masks"]) for _, row in rows]
    expected = [(i, None, (str(masks[i]),)) for i in (0, 1)]
    expected += [(i, i, ("masks.npy",)) for i in (0, 1)]
    assert of_rows[:6] == [*expected, *((i, None, (str(masks[0]),)) for i in (0, 1))]
    assert of_rows[8] == (None, None, ("masks.npy",))
    items(HEADER, f"clouds.npy,{masks[0]};{masks[1]},a.ply,2,best")
    assert tso("batch", "items.csv", "-o", "out", "--json").document["done"] == 2
    assert tso("refine", "clouds.npy", masks[1], "--cloud-index", 1, "--steps", 2, "-o",
               "b.ply").code == 0  # fmt: skip
    np.testing.assert_array_equal(*(read_cloud(f).points for f in ("out/a_1.ply", "b.ply")))
    assert "choose one of them: --cloud-index 0 to 1" in tso("refine", "clouds.npy",
                                                             masks[1]).refusal  # fmt: skip


def test_the_second_run_does_only_what_is_left_or_changed(items, tso):
    shutil.copy(CHAIR / "initial.ply", "cloud.ply")
    items(HEADER, row("a.ply"), row("b.ply", "cloud.ply"), row("c.ply", "nothing.ply"))
    first = tso("batch", "items.csv", "-o", "out", "-q")
    assert first.code == 3
    assert first.out == ""
    points = read_cloud("cloud.ply").points
    write_cloud("cloud.ply", points * 1.01, overwrite=True)
    Path("out/a.ply").unlink()
    second = tso("batch", "items.csv", "-o", "out")
    assert "3 of 3 items: 2 done, 1 refused" in second.out
    assert "refused  c.ply: nothing.ply: cannot be read" in second.out
    assert second.code == 3
    third = tso("batch", "items.csv", "-o", "out")
    assert "3 of 3 items: 2 done, 1 refused" in third.out
    assert "2 ended in earlier runs" in third.out
    assert third.code == 3


def test_a_file_that_an_item_asks_for_later_is_made(items, tso):
    items(HEADER, row("a.ply"))
    assert tso("batch", "items.csv", "-o", "out", "-q").code == 0
    items(f"{HEADER},overlay", row("a.ply", more="2,best,a.png"))
    for skipped in (0, 1):
        again = tso("batch", "items.csv", "-o", "out", "--json").document
        assert (again["done"], again["skipped"]) == (1, skipped)
        assert Path("out/a.png").is_file()


def test_the_key_of_an_item_says_what_each_of_its_files_is():
    item = {"source": Path("a.ply"), "masks": (Path("a.png"), Path("b.png"))}
    other = {"source": Path("a.ply"), "masks": (Path("a.png"),)}
    ways = [item, {**other, "ignore": (Path("b.png"),)}, {**other, "depth": (Path("b.png"),)}]
    assert len({key_of(way, ["1", "2", "3"]) for way in ways}) == len(ways)


def test_results_that_are_not_of_this_batch_are_not_replaced(items, tso):
    items(HEADER, row("a.ply"))
    Path("out").mkdir()
    Path("out/a.ply").write_text("mine")
    for _ in range(2):
        assert tso("batch", "items.csv", "-o", "out", "-q").code == 3
        assert Path("out/a.ply").read_text() == "mine"
    assert tso("batch", "items.csv", "-o", "out", "--overwrite", "-q").code == 0


# The mask is of another object.
PLANE = EXAMPLES / "airplane"
DOUBTFUL = f"{CHAIR / 'initial.ply'},{PLANE / 'mask.png'},{PLANE / 'camera.json'}"


def test_a_batch_with_a_doubtful_item_never_seems_to_be_all_done(items, tso):
    items("cloud,mask,camera", DOUBTFUL)
    for skipped in (0, 1):
        shown = tso("batch", "items.csv", "-o", "out")
        assert shown.code == 3
        assert "1 of 1 items: 1 doubtful" in shown.out
        assert "  doubtful initial.refined.ply: confidence 0." in shown.out
        assert ("1 ended in earlier runs" in shown.out) == bool(skipped)


def test_only_doubtful_items_are_done_again_where_strict_changes(items, tso):
    right = f"{CHAIR / 'initial.ply'},{CHAIR / 'mask.png'},{CHAIR / 'camera.json'}"
    items("cloud,mask,camera,output", f"{DOUBTFUL},a.ply", f"{right},b.ply")
    for more, skipped in (((), 0), (("--strict",), 1), (("--strict",), 2), ((), 1)):
        found = json.loads(tso("batch", "items.csv", "-o", "out", "-q", "--json", *more).out)
        assert (found["done"], found["doubtful"], found["skipped"]) == (1, 1, skipped)


def test_an_item_stays_of_its_batch_whatever_became_of_it_since(items, tso):
    shutil.copy(CHAIR / "initial.ply", "cloud.ply")
    items(HEADER, row("a.ply", "cloud.ply"))
    assert tso("batch", "items.csv", "-o", "out", "-q").code == 0
    whole = Path("cloud.ply").read_bytes()
    Path("cloud.ply").write_bytes(whole[:-40])
    assert tso("batch", "items.csv", "-o", "out", "-q").code == 3
    Path("cloud.ply").write_bytes(whole)
    assert tso("batch", "items.csv", "-o", "out", "-q").code == 0
    assert ends_of("out/journal.jsonl") == {"a.ply": ["done", "refused", "done"]}
    Path("out/a.record.json").unlink()
    assert tso("batch", "items.csv", "-o", "out", "-q").code == 0
    assert Path("out/a.record.json").exists()


def test_runs_with_other_parts_go_on_but_not_at_the_same_time(items, tso):
    items(HEADER, *(row(f"{number}.ply") for number in range(6)))
    for index in (1, 2):
        assert tso("batch", "items.csv", "-o", "out", "--shard", f"{index}/2", "-q").code == 0
    whole = json.loads(tso("batch", "items.csv", "-o", "out", "-q", "--json").out)
    assert (whole["done"], whole["skipped"]) == (6, 6)
    third = ("batch", "items.csv", "-o", "out", "-q", "--shard", "1/3")
    assert tso(*third).code == 0
    command = "from pathlib import Path; from tso_cli.batch.journal import open_journal; import sys"
    command += "\nwith open_journal(Path(sys.argv[1])): print('open', flush=True); input()"
    with subprocess.Popen([sys.executable, "-c", command, "out/journal.jsonl"], text=True,
                          stdin=subprocess.PIPE, stdout=subprocess.PIPE) as other:  # fmt: skip
        assert other.stdout.readline() == "open\n"
        assert "journal.jsonl: another process is writing it" in tso(*third).refusal
        other.communicate("\n")


def test_a_full_disk_loses_no_item(items, tso, monkeypatch):
    """`write_cloud` finds the disk full, in this process."""
    from tso_cli.batch.run import Task
    from tso_cli.commands.batch import item
    from tso_cli.commands.refine import outputs

    def full(*arguments, **more):
        raise InputError("a.ply: cannot be written") from OSError(errno.ENOSPC, "no space")

    files = (str(CHAIR / "initial.ply"), str(CHAIR / "mask.png"))
    given = {"steps": 1, "output": "a.ply", "source": files[0], "masks": files[1:]}
    monkeypatch.setattr(outputs, "write_cloud", full)
    outcome = item.refine_item(Task("a.ply", given), None)
    assert outcome.event == "failed"
    assert outcome.key is None


def test_files_that_no_batch_has_written_are_not_replaced(items, tso):
    items(HEADER, row("a.ply"))
    Path("out").mkdir()
    for name, code in (("index.html", 2), ("a.record.json", 3)):
        Path("out", name).write_text("mine")
        assert tso("batch", "items.csv", "-o", "out", "-q", "--report").code == code
        assert Path("out", name).read_text() == "mine"
        Path("out", name).unlink()


def test_no_doubtful_result_is_written_if_that_is_asked(items, tso):
    """A car's mask for a chair."""
    items("cloud,mask", f"{CHAIR / 'initial.ply'},{EXAMPLES / 'airplane/mask.png'}")
    assert tso("batch", "items.csv", "-o", "out", "--strict", "-q").code == 3
    (entry,) = [e for e in entries(Path("out/journal.jsonl")) if e["event"] != "started"]
    assert entry["event"] in ("doubtful", "refused")
    assert entry["reason"]
    assert not Path("out/initial.refined.ply").exists()


def test_shards_together_do_every_item_once(items, tso):
    items(HEADER, *(row(f"{number}.ply") for number in range(5)))
    for index in (1, 2):
        assert tso("batch", "items.csv", "-o", "out", "--shard", f"{index}/2", "-q").code == 0
    ends = [ends_of(f"out/{index}-of-2.journal.jsonl") for index in (1, 2)]
    assert not ends[0].keys() & ends[1].keys()
    assert {**ends[0], **ends[1]} == {f"{number}.ply": ["done"] for number in range(5)}


@pytest.mark.parametrize(
    ("header", "rows", "message"),
    [
        (
            HEADER,
            ["a.ply,m.png,x.ply,many,paper"],
            "row 2: steps is 'many', expected a whole number, 0 or more",
        ),
        (
            HEADER,
            ["a.ply,m.png,x.ply,2,fast"],
            "row 2: preset is 'fast', expected one of best, paper",
        ),
        ("cloud,mask,stepps", ["a.ply,m.png,3"], "column 'stepps' is no option .*, expected steps"),
        ("cloud,mask_path", ["a.ply,m.png"], "column 'mask_path' is no option .*, expected mask,"),
        ("cloud,mask,steps", ["a.ply,m.png,5.5"], "steps is '5.5', expected a whole number"),
        ("cloud,mask,check", ["a.ply,m.png,1"], "column 'check' is not for one item"),
        ("cloud,mask,refine-camera", ["a.ply,m.png,maybe"], "expected true or false"),
        ("cloud,mask", ["a.ply,m.png"] * 2, "row 3: output: .*row 2 writes a.refined.record.json"),
        ("cloud,mask,output", ["a.ply,m.png,x.ply", "a.ply,m.png,x.npy"], "writes x.record.json"),
        (
            "cloud,mask,report",
            ["a.ply,m.png,r.html", "b.ply,m.png,./r.html"],
            "row 3: report: .*row 2 writes r.html too",
        ),
        ("cloud,mask,overlay", ["a.ply,m.png,../p.png"], "row 2: overlay is '../p.png', expected"),
        ("cloud,mask,rerun", ["a.ply,m.png,/tmp/p.rrd"], "row 2: rerun is '/tmp/p.rrd', expected"),
        ("cloud,mask,report", ["a.ply,m.png,s3://b/r.html"], "only output may be an address"),
        ("cloud,mask,report", ["a.ply,m.png,index.html"], "report is index.html, which tso batch"),
        ("cloud,mask,write-camera", ["a.ply,m.png,b.record.json"], "which tso batch writes itself"),
        ("cloud,mask,report", ["a.ply,m.png,r.htm"], "row 2: report: .*'.htm', expected .html"),
        ("cloud,mask,symmetry", ["a.ply,m.png,q"], "row 2: symmetry is 'q', expected auto"),
        ("cloud,mask,output", ["a.ply,m.png,a.txt"], "row 2: output: .*'.txt', expected .ply"),
        ("cloud,mask,output", ["a.ply,m.png,a.glb"], "row 2: output: .*'.glb', expected .ply"),
        ("cloud,mask,assume", ["a.ply,m.png,mask-inverter"], "row 2: --assume is 'mask-inverter'"),
        ("cloud,mask,gamma", ["a.ply,m.png,-1"], "row 2: gamma is '-1', expected a number from 0"),
        ("cloud,mask,depth", ["a.ply,,d.png"], "row 2: no MASK was given"),
        ("cloud,mask,mode,refine-camera", ["a.png,m.png,encoder,1"], "row 2: --refine-camera is"),
        ("cloud,mask", ["a.ply,m.png;./m.png"], "row 2: mask is .*, expected each mask once"),
        ("cloud,mask,source", ["a.ply,m.png,b.ply"], "row 2: the columns cloud and source are the"),
        ("cloud,mask,strict", ["a.ply,m.png,1"], "'strict' is not for one item: the option --stri"),
        ("cloud,mask,overwrite", ["a.ply,m.png,1"], "the option --overwrite sets it for all"),
        ("cloud,mask,record", ["a.ply,m.png,1"], "'record' is not for one item: tso batch sets it"),
        ('{"cloud": 3}', [], "row 1: cloud is 3, expected a path"),
        ('{"cloud": "a.ply", "mask": []}', [], r"row 1: mask is \[\], expected a path"),
        ('{"cloud": "a.ply", "mask": "m.png", "output": 3}', [], "row 1: output is 3, expected"),
        ("cloud,mask,assume", ["a.ply,m.png,list"], "assume is list, expected a name"),
        ("cloud,mask,output", ["a.ply,m.png,../x.ply"], "expected a name below the folder"),
        ("cloud,mask,output", ["a.ply,m.png,s3://a/../x.ply"], "expected a name below the folder"),
        ("cloud,mask,output", ["a.ply,m.png,/x.ply"], "expected a name below the folder"),
        ("cloud,mask,output", ["a.ply,m.png,~/x.ply"], "expected a name below the folder"),
        ("cloud,mask,output", ["a.ply,m.png,..\\x.ply"], "expected a name below the folder"),
        ("cloud,mask,output", ["a.ply,m.png,file:///f/x.ply"], "expected a name below the folder"),
        ("cloud,mask,output", ["a.ply,m.png,local:///f/x.ply"], "expected a name below the folder"),
        ("cloud,mask,output", ["a.ply,m.png,memory://x.ply"], "expected a name below the folder"),
        (
            "cloud,mask,output",
            ["a.ply,m.png,simplecache::file:///f/x.ply"],
            "expected a name below the folder",
        ),
    ],
)
def test_a_wrong_row_is_refused_before_anything_is_done(items, tso, header, rows, message):
    import re

    items(header, *rows)
    refusal = tso("batch", "items.csv", "-o", "out").refusal
    assert re.search(message, refusal), refusal
    assert "items.csv" in refusal
    assert not Path("out").exists()


def test_the_folder_of_a_batch_is_no_address(items, tso, tmp_path):
    items(HEADER, row("a.ply"))
    refusal = tso("batch", "items.csv", "-o", "s3://bucket/out").refusal
    assert "is an address, expected a folder" in refusal
    assert {path.name for path in tmp_path.iterdir()} == {"items.csv"}


def test_the_options_that_hold_for_all_items_are_those_of_the_batch():
    options = {parameter.name: parameter.opts for parameter in batch_command.params}
    assert all(option in options[name] for name, option in OF_BATCH.items())


def test_files_of_an_item_are_known_before_it_begins():
    values = {"cloud": "a.ply", "mask": "m.png", "overlay": "p.png", "write_camera": "in/c.json"}
    row = Item("row 1", {**values, "steps": "2"})
    ((name, given),) = options_of_items([row], "in", Path("out"), False)
    assert name == "a.refined.ply"
    files = ["out/a.refined.ply", "out/a.refined.record.json", "out/in/c.json", "out/p.png"]
    assert sorted(written_by(given)) == sorted(files)
    assert written_by(given)[:2] == files[:2]
    plain = Item("row 1", {**values, "overlay": "./q.png"})
    ((_, given),) = options_of_items([plain], "in", Path("out"), False)
    assert set(written_by(given)) == {*files[:3], "out/q.png"}
    far = Item("row 1", {"cloud": "a.ply", "mask": "m.png", "output": "s3://b/a.ply"})
    ((_, given),) = options_of_items([far], "s3://c", Path("out"), False)
    assert written_by(given) == ["s3://b/a.ply", "s3://b/a.record.json"]
    assert (given["source"], given["masks"]) == ("s3://c/a.ply", ("s3://c/m.png",))


@pytest.mark.parametrize("output", [".", "in", "../here/in"])
def test_no_item_writes_what_another_one_reads(tmp_path, monkeypatch, output):
    folder = tmp_path / "here"
    (folder / "in").mkdir(parents=True)
    monkeypatch.chdir(folder)
    name = "in/b.png" if output == "." else "b.png"
    row = {"cloud": "a.ply", "mask": "a.png", "overlay": name}
    other = {"cloud": "b.ply", "mask": "b.png"}
    items = [Item("row 1", row), Item("row 2", other)]
    message = r"row 1: would write .*b\.png, which row 2 reads"
    assert_refused(message, options_of_items, items, "in", Path(output), False)
    assert options_of_items(items, "elsewhere", Path(output), False)
    # Its own input is replaced as by `tso refine --overwrite`.
    own = [Item("row 1", {"cloud": "a.ply", "mask": "a.png", "output": "a.ply"})]
    assert options_of_items(own, "", Path("."), False)
    manifest = [Item("row 1", {**other, "write-camera": "m.json"})]
    message = "which the manifest reads"
    assert_refused(message, options_of_items, manifest, "", Path("."), False, (1, 1), "m.json")


def test_a_shard_refuses_what_two_shards_would_write():
    items = [
        Item(f"row {n}", {"cloud": f"{n}.ply", "mask": "m.png", "report": "r.html"})
        for n in range(8)
    ]
    for index in range(1, 5):
        assert_refused("r.html", options_of_items, items, "", Path("out"), False, (index, 4))


def test_a_record_repeats_its_run_wherever_it_is_read(folder, tso, monkeypatch):
    first = ("refine", "initial.ply", "mask.png", "--steps", 3, "--preset", "paper", "--record")
    Path("in").mkdir()
    assert tso(*first, "-o", "in/first.ply").code == 0
    record = json.loads(Path("in/first.record.json").read_text())
    assert record["schema"] == 1
    assert set(record["inputs"]) == {"../initial.ply", "../mask.png", "../camera.json"}
    assert record["options"]["masks"] == ["../mask.png"]
    assert record["command"].startswith("tso refine initial.ply mask.png --preset paper --steps 3")
    before = Path("in/first.ply").read_bytes()
    monkeypatch.chdir("in")
    Path("first.ply").unlink()
    assert tso("refine", "--config", "first.record.json", "-q").code == 0
    assert Path("first.ply").read_bytes() == before


def test_options_of_a_file_stand_for_those_that_are_not_given(folder, tso):
    Path("in").mkdir()
    Path("in/o.toml").write_text('mask = ["../mask.png"]\nsteps = 2\npreset = "paper"\n')
    found = tso("refine", "initial.ply", "--config", "in/o.toml", "--json", "-o", "a.ply").document
    assert found["steps"] == 2
    assert found["preset"] == "paper"
    assert found["options"]["steps"] == 2
    more = ("--steps", 1, "--json", "-o", "b.ply")
    assert tso("refine", "initial.ply", "--config", "in/o.toml", *more).document["steps"] == 1


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("o.json", "[]", "holds"),
        ("o.json", "{", "cannot be read"),
        ("o.toml", "a = ", "cannot be read"),
        ("o.json", '{"stepps": 1}', "'stepps' is no option of refine"),
        ("o.json", '{"schema": 99, "options": {}}', "is a record of schema 99, expected 1"),
        ("o.json", '{"schema": 1}', "has no options"),
    ],
)
def test_a_wrong_file_of_options_is_refused(folder, tso, name, text, message):
    Path(name).write_text(text)
    assert message in tso("refine", "initial.ply", "mask.png", "--config", name).refusal


def started(tmp_path, environment, *more):
    command = [sys.executable, "-m", "tso_cli", "batch", "items.csv", "-o", "out", "-q", *more]
    return subprocess.Popen(command, cwd=tmp_path, env=environment, stderr=subprocess.DEVNULL)


@linux
@pytest.mark.slow
def test_after_any_kills_every_item_ends_once_and_nothing_is_left():
    cases = long_batch(100, 8, "processes", 0, Progress(), between=(0.5, 2.5))
    claims = conclude(cases)["claims"]
    left = [one for one in claims if "kills" in one["claim"] or "no temporary" in one["claim"]]
    assert len(left) == 3
    assert all(one["holds"] for one in left), left


@linux
@pytest.mark.slow
def test_a_cluster_of_dask_loses_nothing_and_names_the_poison(items, tmp_path):
    """Two workers, one of which is killed on the way, and an item that kills its worker."""
    pytest.importorskip("distributed")
    write_poison(tmp_path / "plugin")
    path = f"{tmp_path}/plugin:{Path(__file__).parents[2]}"
    environment = os.environ | {"PYTHONPATH": path, "OMP_NUM_THREADS": "2"}
    Path("p.poison").write_text("x")
    names = [f"{number}.ply" for number in range(40)]
    items(HEADER, *(row(name) for name in names), row("poison.ply", "p.poison"))
    process = started(tmp_path, environment, "--engine", "dask", "-j", "2")
    journal = Path("out/journal.jsonl")
    until = time.monotonic() + 60.0
    while not (journal.exists() and journal.read_text().count('"done"') >= 5):
        assert time.monotonic() < until
        time.sleep(0.02)
    # The last child is a worker; the first are those that watch over the others.
    os.kill(max(processes_of(process.pid)), signal.SIGKILL)
    assert process.wait() == 3
    ends = ends_of(journal)
    assert ends.pop("poison.ply") == ["failed"]
    assert ends == {name: ["done"] for name in names}
    assert "its process died" in journal.read_text()


def test_one_ctrl_c_is_never_lost(items, tso, monkeypatch):
    """An engine may swallow the exception that Ctrl-C raises while the engine starts."""
    from tso_cli.commands.batch import run as batch_run

    def swallowed():
        with contextlib.suppress(BaseException):
            signal.raise_signal(signal.SIGINT)

    @contextlib.contextmanager
    def starting(*arguments):
        swallowed()
        with engine(*arguments) as used:
            yield used

    items(HEADER, *(row(f"{number}.ply") for number in range(4)))
    monkeypatch.setattr(batch_run, "engine", starting)
    shown = tso("batch", "items.csv", "-o", "out")
    assert shown.code == 130
    assert "0 of 4 items" in shown.out
    assert "the same command goes on" in shown.out


def test_a_cluster_that_is_not_there_is_refused(items, tso):
    pytest.importorskip("distributed")
    items(HEADER, row("a.ply"))
    more = ("--engine", "dask", "--scheduler", "tcp://127.0.0.1:1")
    found = tso("batch", "items.csv", "-o", "out", "-q", *more)
    assert found.code == 1
    assert "no worker of tcp://127.0.0.1:1 can be reached" in found.err
    assert "--engine dask" in tso("batch", "items.csv", "-o", "out", "--scheduler", "x").refusal


def test_the_index_shows_every_item_with_its_last_end(items, tso):
    items(HEADER, row("a.ply"), row("in/<b>.ply"), row("c.ply", "nothing.ply"))
    assert tso("batch", "items.csv", "-o", "out", "--report", "-q").code == 3
    page = Path("out/index.html").read_text()
    rows = json.loads(page.partition('id="rows">')[2].partition("</script>")[0])["rows"]
    assert [one["event"] for one in rows].count("done") == 2
    assert {one.get("picture") for one in rows} == {
        "pictures/a.ply.png", "pictures/in/%3Cb%3E.ply.png", None,
    }  # fmt: skip
    assert Path("out/pictures/in/<b>.ply.png").is_file()
    assert "<b>" not in page


FAR = """
from fsspec.implementations.local import LocalFileSystem


class Far(LocalFileSystem):
    protocol = "far"

    @classmethod
    def _strip_protocol(cls, path):
        return LocalFileSystem._strip_protocol(str(path).removeprefix("far://"))
"""


@pytest.fixture
def far(tmp_path_factory, monkeypatch):
    """A store at far://, of which the processes know as of one that another package brings."""
    fsspec = pytest.importorskip("fsspec")
    package = tmp_path_factory.mktemp("package")
    about = package / "far-1.dist-info"
    about.mkdir()
    (package / "far_store.py").write_text(FAR)
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: far\nVersion: 1\n")
    (about / "entry_points.txt").write_text("[fsspec.specs]\nfar = far_store.Far\n")
    monkeypatch.syspath_prepend(package)
    fsspec.register_implementation("far", "far_store.Far", clobber=True)


def chair_at_an_address(folder):
    """The address of a folder with cloud, mask and camera of the chair."""
    for name in ("initial.ply", "mask.png", "camera.json"):
        shutil.copy(CHAIR / name, folder / name)
    return f"far://{folder}"


@pytest.mark.usefixtures("far")
def test_inputs_and_results_may_be_at_addresses(items, tso, tmp_path):
    here = chair_at_an_address(tmp_path)
    items(
        "cloud,mask,camera,output,steps,preset",
        f"{here}/initial.ply,{here}/mask.png,{here}/camera.json,{here}/far/a.ply,2,best",
        "initial.ply,mask.png,camera.json,b.ply,2,best",
        f"{here}/nothing.ply,mask.png,camera.json,c.ply,2,best",
    )
    found = tso("batch", "items.csv", "-o", "out", "-q", "--json")
    assert found.code == 3
    (refused,) = json.loads(found.out)["not_done"]
    assert refused["reason"] == f"{here}/nothing.ply: does not exist, expected a file"
    results = [read_cloud(path).points for path in ("far/a.ply", "out/b.ply")]
    np.testing.assert_array_equal(*results)
    assert sorted(path.name for path in Path("far").iterdir()) == ["a.ply", "a.record.json"]
    again = json.loads(tso("batch", "items.csv", "-o", "out", "-q", "--json").out)
    assert again["skipped"] == 2
    os.utime("initial.ply", (0, 0))
    assert json.loads(tso("batch", "items.csv", "-o", "out", "-q", "--json").out)["skipped"] == 1
    Path("out/journal.jsonl").unlink()
    assert (
        "exists already"
        in json.loads(tso("batch", "items.csv", "-o", "out", "-q", "--json").out)["not_done"][0][
            "reason"
        ]
    )


@pytest.mark.usefixtures("far")
def test_a_camera_next_to_a_remote_mask_is_found_and_the_record_names_addresses(
    items, tso, tmp_path
):
    here = chair_at_an_address(tmp_path)
    items(
        "cloud,mask,output,steps,preset,report,write-camera",
        f"{here}/initial.ply,{here}/mask.png,a.ply,2,best,a.html,a.json",
        f"initial.ply,{here}/mask.png,{here}/far/b.ply,2,best,,",
    )
    assert tso("batch", f"{here}/items.csv", "-o", "out", "-q").code == 0
    own = json.loads(Path("out/a.record.json").read_text())
    assert own["views"][0]["camera"]["source"] == f"{here}/camera.json"
    assert list(own["inputs"]) == [
        f"{here}/{n}" for n in ("initial.ply", "mask.png", "camera.json")
    ]
    assert own["options"]["source"] == f"{here}/initial.ply"
    assert own["options"]["masks"] == [f"{here}/mask.png"]
    assert own["command"].startswith(f"tso refine {here}/initial.ply {here}/mask.png ")
    far = json.loads(Path("far/b.record.json").read_text())
    assert far["output"] == f"{here}/far/b.ply"
    assert far["options"]["masks"] == [f"{here}/mask.png"]
    assert far["options"]["source"] == f"{here}/initial.ply"
    for file in ("out/a.record.json", "out/a.html", "out/a.json", "far/b.record.json"):
        assert "/tso-" not in Path(file).read_text(), file
    os.utime("camera.json", (0, 0))
    again = tso("batch", f"{here}/items.csv", "-o", "out", "-q", "--json").document
    assert again["done"] == 2


@pytest.mark.usefixtures("far")
def test_errors_of_remote_items_name_addresses(items, tso, tmp_path):
    Path("mask.png").write_text("no picture")
    items("cloud,mask", f"{CHAIR / 'initial.ply'},far://{tmp_path}/mask.png")
    assert tso("batch", "items.csv", "-o", "out", "-q").code == 3
    (*_, entry) = entries(Path("out/journal.jsonl"))
    assert entry["reason"].startswith(f"far://{tmp_path}/mask.png: ")


@pytest.mark.parametrize("write", ["{}", "file://{}", "file://localhost{}", "~{}", "\\{}"])
def test_a_cell_names_a_file_as_windows_the_shell_and_browsers_do(tmp_path, monkeypatch, write):
    monkeypatch.setenv("HOME", str(tmp_path))
    cloud = tmp_path / "a chair/a.ply"
    text = {
        "{}": str(cloud), "~{}": "~/a chair/a.ply", "\\{}": "a chair\\a.ply",
    }.get(write, write.format(str(cloud).replace(" ", "%20")))  # fmt: skip
    row = Item("row 1", {"cloud": text, "mask": "m.png", "output": "in\\a.ply"})
    ((name, given),) = options_of_items([row], str(tmp_path), Path("out"), False)
    assert (name, given["source"]) == ("in/a.ply", str(cloud))


def test_columns_of_the_user_are_kept_in_the_journal_and_shown_on_the_page(items, tso):
    items(f",{HEADER},kind", f"7,{row('a.ply', more='2.0,best')},arm chair")
    run = tso("batch", "items.csv", "-o", "out", "--report")
    assert (run.code, "kept in the journal: index, kind" in run.err) == (0, True)
    (*_, entry) = entries(Path("out/journal.jsonl"))
    assert entry["columns"] == {"index": "7", "kind": "arm chair"}
    assert '"columns kind":"arm chair"' in Path("out/index.html").read_text()


@linux
def test_what_is_no_file_or_has_an_impossible_name_ends_its_own_item_alone(items, tso):
    os.mkfifo("pipe.ply")
    items(
        HEADER, row("a.ply", "pipe.ply"), row("b.ply", "/dev/zero"), row("c" * 300 + ".ply"),
        row("d.ply"),
    )  # fmt: skip
    found = json.loads(tso("batch", "items.csv", "-o", "out", "-q", "--json", "--report").out)
    assert found["done"] == 1
    reasons = {one["item"][0]: one["reason"] for one in found["not_done"]}
    assert reasons["a"] == "pipe.ply: is not a regular file, expected one"
    assert reasons["b"] == "/dev/zero: is not a regular file, expected one"
    assert "name too long" in reasons["c"]


@linux
def test_an_item_that_takes_too_long_is_given_up(items, tso):
    items(HEADER, row("a.ply", more="1000000,best"))
    found = tso("batch", "items.csv", "-o", "out", "--item-seconds", 2, "--json", "-q")
    assert (found.code, json.loads(found.out)["not_done"]) == (
        3, [{"item": "a.ply", "event": "failed", "reason": "took over 2 seconds"}],
    )  # fmt: skip


@pytest.mark.parametrize(
    "arguments",
    [
        "initial.ply mask.png",
        "initial.ply mask.png --preset paper --steps 2",
        "initial.ply mask.png --steps 0",
        "initial.ply mask.png --camera fit --write-camera fitted.json",
        "initial.ply mask.png --refine-camera --assume mask-flipped",
        "image.png mask.png --mode encoder --steps 1",
    ],
)
def test_a_record_is_as_its_schema_says(folder, tso, arguments):
    jsonschema = pytest.importorskip("jsonschema")
    schema = json.loads((PACKAGE / "schemas/record.schema.json").read_text())
    jsonschema.Draft202012Validator.check_schema(schema)
    assert tso("refine", *arguments.split(), "--record", "-o", "r.ply", "-q").code == 0
    record = json.loads(Path("r.record.json").read_text())
    jsonschema.validate(record, schema)
    unknown = record.keys() - schema["properties"].keys()
    assert not unknown


def recipe(*words):
    """The line of docs/scale.md that holds the words."""
    lines = (ROOT / "docs/scale.md").read_text().splitlines()
    (line,) = [line for line in lines if all(word in line for word in words)]
    return line


@linux
def test_the_recipe_for_slurm_does_every_item_once(items, tmp_path):
    """`srun` only runs what it is given, as on a cluster of one machine."""
    items(HEADER, *(row(f"{number}.ply") for number in range(3)))
    line = recipe("srun", "SLURM_ARRAY_TASK_ID").replace("/64 -j 16", "/2 -q")
    script = f'srun() {{ "$@"; }}\ntso() {{ {sys.executable} -m tso_cli "$@"; }}\n{line}\n'
    for index in (1, 2):
        variables = {"SLURM_ARRAY_TASK_ID": str(index)}
        environment = os.environ | variables | {"PYTHONPATH": str(ROOT)}
        subprocess.run(["sh", "-c", script], env=environment, cwd=tmp_path, check=True)
    ends = [ends_of(path) for path in sorted(Path("results").glob("*.jsonl"))]
    assert {**ends[0], **ends[1]} == {f"{number}.ply": ["done"] for number in range(3)}
    assert not ends[0].keys() & ends[1].keys()


@pytest.mark.skipif(not shutil.which("parallel"), reason="GNU parallel is not installed")
def test_the_recipe_for_gnu_parallel_does_every_item_once(items, tmp_path):
    items(HEADER, *(row(f"{number}.ply") for number in range(3)))
    line = recipe("parallel", "--sshloginfile").replace("--sshloginfile machines.txt --wd .", "")
    command = line.replace(" tso ", f" {sys.executable} -m tso_cli ").replace("{}/8", "{}/2")
    command = command.partition(":::")[0] + "-q ::: 1 2"
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    subprocess.run(["sh", "-c", command], env=environment, cwd=tmp_path, check=True)
    ends = [ends_of(path) for path in sorted(Path("results").glob("*.jsonl"))]
    assert {**ends[0], **ends[1]} == {f"{number}.ply": ["done"] for number in range(3)}


@pytest.mark.parametrize(
    "more", [{"mask": 5}, {"mask": [1]}, {}, {"mask": "a.png", "output": ""}], ids=str
)
def test_a_row_of_an_array_is_refused_as_that_of_a_cloud_is(items, tso, more):
    items("cloud,mask", "")
    np.save("array.npy", np.random.default_rng(0).normal(size=(2, 5, 3)))
    Path("rows.jsonl").write_text(json.dumps({"cloud": "array.npy", **more}) + "\n")
    run = tso("batch", "rows.jsonl", "-o", "out", "--quiet")
    assert run.code in (1, 2)
    assert not list(Path("out").glob("**/*.ply"))
