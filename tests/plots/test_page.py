"""The page of a refinement: whole, small, safe, and alive in a browser."""

import base64
import io
import json
import re
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from tests.cli.conftest import save_untrained
from tests.scenes import EXAMPLES, seen, turned
from tso_cli import Camera, RefineConfig, View
from tso_cli import refine as refine_points
from tso_cli.cli import main
from tso_cli.io import paint
from tso_cli.io.cameras import CameraRecord, write_cameras
from tso_cli.io.clouds import read_cloud
from tso_cli.io.paint import Paint, Texture
from tso_cli.io.views import ViewFiles
from tso_cli.plots.page.pictures import outline, packed
from tso_cli.plots.page.solid import (
    MOST_FACES,
    MOST_POINTS,
    MovedSurface,
    _simplified,
    _texture_uris,
    solid_of,
)
from tso_cli.plots.page.write import as_json, text
from tso_cli.refinement.scene import as_scene
from tso_cli.scene.load import Scene, load_points_scene
from tso_cli.scene.photos import photos_of

from .browser import CHROMIUM, Browser

CHAIR = EXAMPLES / "chair"
STAGE = (32, 38, 45)  # the colour behind what is drawn
LARGEST = 6_000_000  # bytes
needs_chromium = pytest.mark.skipif(CHROMIUM is None, reason="there is no chromium")


def scene_of(points, view):
    return Scene(as_scene(points, view), ("given",), "camera given", "input")


def solid(page):
    """The data of the three-dimensional view."""
    found = re.search(r'<script type="application/json" id="solid">(.*?)</script>', page, re.DOTALL)
    return json.loads(found[1])


def visible_answers(page):
    """The sentences above the three-dimensional view."""
    return page.partition("<section class=answers>")[2].partition("</section>")[0]


def without_library(page):
    return re.sub(r"<!--.*?-->|<script>.*?</script>", "", page, flags=re.DOTALL)


def unpacked(numbers):
    steps = np.frombuffer(base64.b64decode(numbers["data"]), "<u2")
    steps = steps.reshape(-1, len(numbers["low"]))
    return steps * np.array(numbers["span"]) + numbers["low"]


# What is in the page


def test_a_page_says_what_the_command_prints_and_loads_nothing(folder, refine):
    run = refine("initial.ply", "mask.png", "--steps", "12", "--report", "chair.html")
    page = Path("chair.html").read_text()
    assert run.out.splitlines()[-1] == "chair.html: page"
    assert len(page.encode()) < LARGEST
    printed = dict(re.findall(r"(?m)^  (\w+) +(.*)$", run.out))
    visible = without_library(page).replace("&gt;", ">").replace("&#x27;", "'").replace("\xa0", " ")
    assert printed["IoU"] in visible
    assert printed["moved"] in visible
    assert "assumed mirror-symmetric, as the cloud is" in visible
    assert "tso refine initial.ply mask.png --steps 12 --report chair.html" in visible
    assert "://" not in without_library(page)
    assert re.search(r"default-src 'none'; script-src 'sha256-", page)
    # Names of XML, which are loaded from nowhere.
    assert set(re.findall(r"https?://[\w./]+", page)) <= {"http://www.w3.org/1999/xhtml"}


def test_names_of_files_and_warnings_are_text_whatever_they_hold(folder, refine):
    name = "<script>alert(1)<b>&amp;'\".png"
    Path(name).write_bytes(Path("mask.png").read_bytes())
    assert refine("initial.ply", name, "--steps", "2", "--report", "page.html").code == 0
    page = Path("page.html").read_text()
    assert "<script>alert" not in page
    assert "<b>&" not in page
    assert solid(page)["cameras"][0]["name"] == name


def test_a_name_cannot_end_the_script_that_holds_it(folder):
    name = "</script><b>.png"
    assert "<" not in as_json({"name": name})
    assert json.loads(as_json({"name": name})) == {"name": name}
    assert text(name) == "&lt;/script&gt;&lt;b&gt;.png"


def test_the_document_of_json_names_the_page_and_is_in_it(folder, refine):
    arguments = ("initial.ply", "mask.png", "--steps", "2", "--report", "page.html", "--json")
    document = refine(*arguments).document
    assert document["report"] == "page.html"
    assert "&quot;iou_before&quot;" in Path("page.html").read_text()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--report", "page.png"), "page.png: the suffix is '.png', expected .html"),
        (("--report", "old.html"), "old.html: exists already, expected a new name or --overwrite"),
    ],
)
def test_a_page_that_cannot_be_written_is_refused_before_the_work(folder, refine, arguments, words):
    Path("old.html").write_text("precious")
    assert words in refine("initial.ply", "mask.png", *arguments).refusal
    assert not list(folder.glob("*refined*"))


def test_a_page_does_not_replace_an_input(folder, refine):
    # A camera file may have any name.
    Path("camera.json").rename("camera.html")
    arguments = ("--camera", "camera.html", "--report", "camera.html", "--overwrite")
    refusal = refine("initial.ply", "mask.png", *arguments).refusal
    assert "camera.html: is an input, expected another name for --report" in refusal


def test_without_a_trusted_result_strict_writes_no_page(folder, refine):
    Image.open("mask.png").transpose(Image.Transpose.FLIP_LEFT_RIGHT).save("flipped.png")
    arguments = ("--camera", "camera.json", "--report", "page.html", "--strict")
    run = refine("initial.ply", "flipped.png", *arguments)
    assert run.code == 3
    assert not Path("page.html").exists()
    assert not list(folder.glob("*refined*"))


def test_what_the_confidence_is_the_page_says_once(folder, refine):
    more = ("--camera", "camera.json", "--overwrite", "--report")
    refine("initial.ply", "mask.png", "--steps", "12", *more, "sure.html")
    np.save("few.npy", read_cloud("initial.ply").points[:15])
    refine("few.npy", "mask.png", *more, "none.html")
    sure, none = (visible_answers(Path(name).read_text()) for name in ("sure.html", "none.html"))
    assert sure.count("Chamfer distance") == 1
    assert "<b>Confidence</b>" not in none
    assert "There is no confidence in this run." in none


def test_a_mesh_whose_vertices_move_farther_than_its_control_points_has_both_numbers(pages):
    page = pages["mesh"].read_text()
    largest = f"{100 * solid(page)['largest']:.1f}\xa0%"
    assert page.count(f"the vertices below move by {largest} at most.") == 1
    assert f"<span>{largest}</span></span></div>".replace("\xa0", " ") in page
    assert "below move by" not in pages["cloud"].read_text()


# Numbers and outlines


def test_packed_numbers_come_back_to_a_65000th_of_their_range(cloud):
    np.testing.assert_allclose(unpacked(packed(cloud)), cloud, atol=0.5 / 65000)
    assert unpacked(packed(np.ones((3, 1)))).tolist() == [[1.0]] * 3


def test_an_outline_runs_around_the_pixels_with_the_upper_left_corner_as_origin():
    image = np.zeros((8, 10), np.float32)
    image[2:6, 3:9] = 1.0
    numbers = np.array(re.findall(r"[\d.]+", outline(image)), float).reshape(-1, 2)
    np.testing.assert_allclose(numbers.min(0), [3.0, 2.0], atol=0.51)
    np.testing.assert_allclose(numbers.max(0), [9.0, 6.0], atol=0.51)


def test_a_large_cloud_is_thinned_and_the_page_says_so():
    many = np.random.default_rng(0).uniform(-0.3, 0.3, (MOST_POINTS + 20_000, 3))
    view = seen(many[::40] * 1.1, Camera.canonical(32, 32))
    result = refine_points(many, [view], config=RefineConfig(steps=0))
    drawn = solid_of(result, scene_of(many, view))
    assert 0.9 * MOST_POINTS < drawn["count"] <= MOST_POINTS
    assert "thinned for this page" in drawn["notes"][0]
    assert len(json.dumps(drawn)) < 2_500_000


def test_a_point_far_from_the_rest_is_left_out_and_the_page_says_so(cloud):
    points = np.vstack([cloud, [[50.0, 0.0, 0.0]]])
    view = seen(cloud, Camera.canonical(32, 32))
    result = refine_points(points, [view], config=RefineConfig(steps=0))
    drawn = solid_of(result, scene_of(points, view))
    assert drawn["count"] == len(cloud)
    assert drawn["notes"] == ["1 point is far from the rest, and not drawn."]


def test_a_large_mesh_is_simplified_and_keeps_its_shape():
    sphere = trimesh.creation.icosphere(6)  # 81,920 triangles
    vertices = np.asarray(sphere.vertices) / 2.0
    small = _simplified(MovedSurface(vertices, 1.1 * vertices, np.asarray(sphere.faces)))
    assert len(sphere.faces) > MOST_FACES >= len(small.faces) > 0.3 * MOST_FACES
    np.testing.assert_allclose(small.result, 1.1 * small.start)
    np.testing.assert_allclose(np.linalg.norm(small.start, axis=1), 0.5)


# Photos


def photo_of(size):
    """A picture with many colours."""
    ramp = np.linspace(0, 255, size).astype(np.uint8)
    photo = np.empty((size, size, 3), np.uint8)
    photo[..., 0], photo[..., 1], photo[..., 2] = ramp[None], ramp[:, None], 90
    return photo


def textured_box():
    box = trimesh.creation.box((0.5, 0.4, 0.3)).subdivide().subdivide()
    material = trimesh.visual.material.PBRMaterial(baseColorTexture=Image.fromarray(photo_of(64)))
    box.visual = trimesh.visual.TextureVisuals(box.vertices[:, :2] + 0.5, material=material)
    return box


def test_a_mesh_whose_textures_are_too_large_is_drawn_without_them_and_the_page_says_so(
    folder, refine, monkeypatch
):
    textured_box().export("box.glb")
    monkeypatch.setattr(paint, "MOST_PIXELS", 64)
    arguments = ("--camera", "camera.json", "--steps", "0", "--report", "page.html")
    assert refine("box.glb", "mask.png", *arguments).code == 0
    drawn = solid(Path("page.html").read_text())
    assert drawn["textures"] == []
    (note,) = drawn["notes"]
    words = "the texture 'number 0' is one too many: expected at most 64 pixels in all"
    assert note.startswith(f"A texture is not drawn: {words}")


def test_a_picture_that_two_parts_share_is_drawn_in_the_colour_of_each():
    white, places = np.full((4, 4, 3), 200, np.uint8), np.zeros((1, 3, 2))
    tints = np.array([[1.0, 0.5, 0.0], [0.0, 0.5, 1.0], [1.0, 1.0, 1.0]], np.float32)
    textures = tuple(Texture(white, np.array([face]), places) for face in range(3))
    uris = _texture_uris(Paint(tints[:, None].repeat(3, axis=1), textures))
    shown = [Image.open(io.BytesIO(base64.b64decode(uri.partition(",")[2]))) for uri in uris]
    colours = [image.convert("RGB").getpixel((1, 1)) for image in shown]
    np.testing.assert_allclose(colours, [[200, 100, 0], [0, 100, 200], [200] * 3], atol=8)


def test_a_mask_with_a_photo_in_its_colours_is_shown_as_a_photo(folder, refine):
    alpha = np.asarray(Image.open("mask.png").convert("L"))
    Image.fromarray(np.dstack([photo_of(256), alpha])).save("cut.png")
    arguments = ("--camera", "camera.json", "--steps", "2", "--report", "page.html")
    assert refine("initial.ply", "cut.png", *arguments, "--overlay", "o.png").code == 0
    assert 'id="photo"' in Path("page.html").read_text()
    refine("initial.ply", "mask.png", *arguments[:-2], "--overlay", "plain.png", "--overwrite")
    pictures = [np.asarray(Image.open(name).convert("RGB")) for name in ("o.png", "plain.png")]
    assert len(np.unique(pictures[0][40:370, 30:360].reshape(-1, 3), axis=0)) > 60
    assert len(np.unique(pictures[1][40:370, 30:360].reshape(-1, 3), axis=0)) < 10


def test_a_photo_is_mirrored_with_its_mask(folder):
    alpha = np.asarray(Image.open("mask.png").convert("L"))
    Image.fromarray(np.dstack([photo_of(256), alpha])).save("cut.png")
    files = ViewFiles([Path("cut.png")], Path("camera.json"))
    for assumed, expected in (((), photo_of(256)), (("mask-flipped",), photo_of(256)[:, ::-1])):
        scene = load_points_scene(Path("initial.ply"), files, assumed)
        (photo,) = photos_of(scene, files)
        np.testing.assert_array_equal(photo, expected)


def test_a_grey_mask_and_an_image_of_labels_are_no_photos(folder):
    mask = np.asarray(Image.open("mask.png").convert("L"))
    Image.fromarray(np.where(mask[..., None] > 127, (220, 20, 60), (0, 0, 0)).astype("u1")).save(
        "labels.png"
    )
    for name in ("mask.png", "labels.png"):
        files = ViewFiles([Path(name)], Path("camera.json"))
        scene = load_points_scene(Path("initial.ply"), files)
        assert photos_of(scene, files) == [None]


@pytest.mark.parametrize("size", [256, 512])
def test_the_photo_of_a_cloud_without_colours_is_shown_and_guides_nothing(folder, refine, size):
    Image.fromarray(photo_of(size)).save("photo.png")
    arguments = ("initial.ply", "mask.png", "--camera", "camera.json", "--steps", "4")
    shown = ("--image", "photo.png", "--report", "page.html", "--overlay", "photo-o.png")
    run = refine(*arguments, *shown, "-o", "photo.ply")
    assert run.err.splitlines() == [
        "tso: warning: the cloud has no colours: the photo is shown, and does not guide the result"
    ]
    page = Path("page.html").read_text()
    assert 'id="photo"' in page
    assert "does not guide the result" in visible_answers(page)
    refine(*arguments, "--overlay", "plain-o.png", "-o", "plain.ply")
    assert Path("photo.ply").read_bytes() == Path("plain.ply").read_bytes()
    assert Path("photo-o.png").read_bytes() != Path("plain-o.png").read_bytes()


def test_the_photo_of_a_cloud_without_colours_has_the_proportions_of_its_mask(folder, refine):
    Image.fromarray(photo_of(256)[:128]).save("flat.png")
    arguments = ("--camera", "camera.json", "--image", "flat.png", "--steps", "0")
    refusal = refine("initial.ply", "mask.png", *arguments).refusal
    assert "flat.png: is 256x128, the mask mask.png is 256x256" in refusal


def test_a_photo_that_is_only_shown_is_mirrored_with_a_left_handed_cloud(folder):
    Image.fromarray(photo_of(512)).save("photo.png")
    files = ViewFiles([Path("mask.png")], Path("camera.json"), image=[Path("photo.png")])
    shown = []
    for assumed in ((), ("cloud-xy-swapped",)):
        with pytest.warns(UserWarning, match="the photo is shown"):
            scene = load_points_scene(Path("initial.ply"), files, assumed)
        shown += photos_of(scene, files)
    np.testing.assert_array_equal(shown[1], shown[0][:, ::-1])


def test_the_picture_that_the_camera_file_names_is_shown(folder):
    Image.fromarray(photo_of(256)).save("photo.png")
    camera = json.loads(Path("camera.json").read_text())
    Path("named.json").write_text(json.dumps(camera | {"image": "photo.png"}))
    files = ViewFiles([Path("mask.png")], Path("named.json"))
    scene = load_points_scene(Path("initial.ply"), files)
    (photo,) = photos_of(scene, files)
    np.testing.assert_array_equal(photo, photo_of(256))
    Path("photo.png").unlink()
    assert photos_of(scene, files) == [None]


def test_the_photo_of_a_network_mode_is_the_part_that_the_network_sees(folder, refine):
    checkpoint = save_untrained(Path("net.safetensors"))
    network = ("--mode", "encoder", "--checkpoint", checkpoint, "--steps", "1")
    run = refine("image.png", "mask.png", *network, "--report", "page.html", "-o", "net.ply")
    assert run.code == 0, run.err
    page = Path("page.html").read_text()
    assert 'id="photo"' in page


# In a browser


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    with Browser(tmp_path_factory.mktemp("chromium")) as opened:
        yield opened


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    """Pages of a cloud with one view, and of a textured mesh with two."""
    folder = tmp_path_factory.mktemp("pages")
    box = textured_box()
    (folder / "box.glb").write_bytes(box.export(file_type="glb"))
    records = []
    points = np.asarray(trimesh.sample.sample_surface(box, 4000, seed=0)[0]) * 1.1
    for number, degrees in enumerate((0.0, 70.0)):
        camera = turned(Camera.canonical(96, 96), degrees)
        view: View = seen(points, camera)
        name = folder / f"mask-{number}.png"
        Image.fromarray((255 * view.mask).astype(np.uint8)).save(name)
        records.append(CameraRecord(camera, name))
    write_cameras(folder / "cameras.json", records)
    for line in (
        [CHAIR / "initial.ply", CHAIR / "mask.png", "-o", folder / "chair.ply"],
        [folder / "box.glb", "--camera", folder / "cameras.json", "-o", folder / "out.glb"],
    ):
        with pytest.raises(SystemExit) as stopped:
            page = line[-1].with_suffix(".html")
            # The box is as large as its masks show it with another focal length.
            words = ["--steps", "24", "-q", "--accept-doubtful", "--report", str(page)]
            main(["refine", *map(str, line), *words])
        assert stopped.value.code == 0
    return {"cloud": folder / "chair.html", "mesh": folder / "out.html"}


def share_of_colour(picture):
    """The share of pixels of the stage that something is drawn on."""
    return (np.abs(picture.astype(int) - STAGE).max(2) > 12).mean()


def differs(first, second):
    return (np.abs(first.astype(int) - second).max(2) > 24).mean()


@needs_chromium
@pytest.mark.parametrize("kind", ["cloud", "mesh"])
@pytest.mark.parametrize("width", [1440, 390])
def test_a_page_opens_without_errors_requests_or_a_horizontal_scroll(browser, pages, kind, width):
    browser.open(pages[kind], width)
    assert browser.errors == []
    assert [url for url in browser.requests if not url.startswith("data:")] == [
        pages[kind].as_uri()
    ]
    assert browser.run("document.documentElement.scrollWidth") <= width
    assert 0.005 < share_of_colour(browser.picture("#canvas")) < 0.8


@needs_chromium
@pytest.mark.parametrize("kind", ["cloud", "mesh"])
@pytest.mark.parametrize("width", [1440, 390])
def test_the_first_view_shows_a_large_object_and_the_cameras_come_when_asked_for(
    browser, pages, kind, width
):
    browser.open(pages[kind], width)
    canvas = browser.picture("#canvas")
    drawn = np.abs(canvas.astype(int) - STAGE).max(2) > 12
    drawn[-85:, :310] = False  # the colour scale
    drawn = drawn[8:-8, 8:-8]  # without the round corners
    rows, columns = (np.flatnonzero(drawn.any(axis)) for axis in (1, 0))
    taken = max(np.ptp(rows), np.ptp(columns)) / min(canvas.shape[:2])
    assert 0.58 < taken < 0.75
    labels = "[...document.querySelectorAll('.tag')].map(label => label.hidden)"
    assert set(browser.run(labels)) == {True}
    browser.run("document.querySelector('#show-cameras').click()")
    assert set(browser.run(labels)) == {False}


@needs_chromium
def test_in_a_narrow_window_the_cells_of_a_row_are_below_each_other(browser, pages):
    browser.open(pages["mesh"], 390)
    cut_off = "[...document.querySelectorAll('.scroll')].map(e => e.scrollWidth - e.clientWidth)"
    assert max(browser.run(cut_off)) <= 0
    widths = "[...document.querySelectorAll('.stacked td')].map(cell => cell.clientWidth)"
    assert min(browser.run(widths)) > 280


@needs_chromium
@pytest.mark.slow
@pytest.mark.parametrize("kind", ["cloud", "mesh"])
def test_the_toggles_change_the_picture_and_reset_brings_it_back(browser, pages, kind):
    browser.open(pages[kind], 700)
    first = browser.picture("#canvas")

    def after(selector):
        browser.run(f"document.querySelector('{selector}').click()")
        return browser.picture("#canvas")

    assert differs(first, start := after("#show-result")) > 0.002
    assert differs(start, empty := after("#show-start")) > 0.002
    assert share_of_colour(empty) < share_of_colour(start)
    after("#show-result")
    assert differs(first, after("#show-start")) == 0.0
    assert differs(first, after("input[value=plain]")) > 0.002
    if kind == "mesh":
        assert differs(first, after("input[value=own]")) > 0.002
    after("input[value=moved]")
    seen_from_far = after("#show-cameras")
    assert differs(first, seen_from_far) > 0.002
    assert differs(seen_from_far, after("#show-cameras")) > 0.0005
    through = after(".look")
    assert differs(first, through) > 0.05
    assert differs(through, after("#backdrop")) > 0.05
    after("#backdrop")
    assert differs(first, after("#reset")) == 0.0
    assert browser.errors == []


@needs_chromium
def test_a_drag_and_the_arrow_keys_rotate(browser, pages):
    browser.open(pages["cloud"], 700)
    first = browser.picture("#canvas")
    browser.drag("#canvas", 150, 40)
    assert differs(first, dragged := browser.picture("#canvas")) > 0.005
    browser.run("document.querySelector('#canvas').focus()")
    browser.press("ArrowRight")
    assert differs(dragged, browser.picture("#canvas")) > 0.005
    browser.press("0")
    browser.run("document.activeElement.blur()")
    assert differs(first, browser.picture("#canvas")) == 0.0


@needs_chromium
@pytest.mark.slow
def test_what_a_camera_sees_lies_on_its_picture(browser, pages):
    """Through the camera, the mesh covers its mask as the IoU says."""
    browser.open(pages["mesh"], 1200)
    browser.run("document.querySelector('#show-start').click()")
    for number in (0, 1):
        browser.run(f"document.querySelectorAll('.look')[{number}].click()")
        browser.run("document.querySelector('input[value=plain]').click()")
        covered = browser.picture("#canvas")
        browser.run("document.querySelector('#show-result').click()")
        bare = browser.picture("#canvas")
        browser.run("document.querySelector('#show-result').click()")
        mesh = np.abs(covered.astype(int) - bare).max(2) > 12
        # The pale shape of the mask is darker than the paper around it, the stage is darkest.
        level = bare.astype(int).min(2)
        middle = level[60:-60]
        mask = (level < (middle.max() - 8)) & (level > 80)
        assert (mesh & mask).sum() / (mesh | mask).sum() > 0.8


@needs_chromium
@pytest.mark.parametrize("name", ["line-mask", "line-start", "line-result"])
def test_outlines_can_be_switched_off(browser, pages, name):
    browser.open(pages["cloud"], 700)
    first = browser.picture(".outlines svg")
    browser.run(f"document.querySelector('#{name}').click()")
    assert differs(first, browser.picture(".outlines svg")) > 0.002


@needs_chromium
def test_a_hostile_name_runs_nothing(browser, folder, refine):
    name = "<img src=x onerror=document.title='broken'>.png"
    Path(name).write_bytes(Path("mask.png").read_bytes())
    refine("initial.ply", name, "--steps", "2", "--report", "page.html")
    browser.open(folder / "page.html", 1200)
    assert browser.run("document.title") == "initial.ply: tso refine"
    assert browser.errors == []
