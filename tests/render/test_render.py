"""Rendering: cameras, rays, surface samples, and folders that can be resumed."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import open3d  # noqa: F401  without it nothing here can be tested: a missing library must fail, not skip
import pytest
from click.testing import CliRunner
from scipy import ndimage

from tso_cli import render
from tso_cli.commands.render import command
from tso_cli.datasets import rendered
from tso_cli.datasets.rendered import open_rendered
from tso_cli.errors import InputError, TsoError
from tso_cli.geometry.camera import CANONICAL_ROTATION, Camera
from tso_cli.geometry.points import farthest_point_sample, sample_surface
from tso_cli.io.meshes import Mesh, write_mesh
from tso_cli.render import RayScene, RenderSettings, render_folder, render_view, sample_cameras
from tso_cli.render.rays import RAYS_AT_ONCE
from tso_cli.render.viewpoints import MARGIN_PX

FAST = RenderSettings(views=3, size=(24, 24), samples=200, points=50)
MANY = ["--views", "300", "--size", "48"]


def box(sides: tuple[float, float, float] = (1.0, 1.0, 1.0), centre: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Mesh:
    """A closed box of 12 triangles."""
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [(a, b, c) for a, b, c, _ in quads] + [(a, c, d) for a, _, c, d in quads]
    return Mesh(corners * sides + centre, np.array(faces, dtype=np.int64))


def joined(*parts: Mesh) -> Mesh:
    starts = np.cumsum([0] + [len(part.vertices) for part in parts])
    faces = [part.faces + start for part, start in zip(parts, starts[:-1], strict=True)]
    return Mesh(np.concatenate([part.vertices for part in parts]), np.concatenate(faces))


def stool() -> Mesh:
    """Not convex, not symmetric: a seat, three legs and a post."""
    legs = [box((0.1, 0.6, 0.1), (x, -0.35, z)) for x, z in ((-0.3, -0.2), (0.3, -0.2), (0.1, 0.2))]
    return joined(box((0.8, 0.1, 0.5)), *legs, box((0.1, 0.5, 0.1), (-0.3, 0.3, 0.0)))


def inside(mask: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    columns, rows = np.rint(pixels).astype(int).T
    return mask[rows, columns] > 0


# Cameras


def test_the_camera_in_front_has_the_canonical_rotation() -> None:
    camera = render.look_at(0.0, 0.0, 2.0, (64, 64))
    canonical = Camera.canonical(64, 64)
    np.testing.assert_allclose(camera.R, CANONICAL_ROTATION, atol=1e-15)
    np.testing.assert_array_equal(camera.K, canonical.K)
    np.testing.assert_array_equal(camera.t, canonical.t)


@pytest.mark.parametrize(("azimuth", "elevation"), [(0, 0), (90, 0), (-40, 30), (200, -80), (10, 90)])
def test_the_camera_stands_where_azimuth_and_elevation_say_and_looks_at_the_origin(azimuth: float, elevation: float) -> None:
    camera = render.look_at(azimuth, elevation, 3.0, (40, 30))
    a, e = np.radians([azimuth, elevation])
    place = 3.0 * np.array([np.cos(e) * np.sin(a), np.sin(e), np.cos(e) * np.cos(a)])
    np.testing.assert_allclose(-camera.R.T @ camera.t, place, atol=1e-14)
    pixels, depth = camera.project(np.zeros((1, 3)))
    np.testing.assert_allclose(pixels, [[19.5, 14.5]])
    assert depth[0] == pytest.approx(3.0)
    assert np.linalg.det(camera.R) == pytest.approx(1.0)
    if abs(elevation) < 90:
        above = camera.project(np.array([[0.0, 0.1, 0.0]]))[0][0]
        assert above[0] == pytest.approx(19.5)
        assert above[1] < 14.5


@pytest.mark.parametrize("size", [(64, 64), (96, 40), (30, 80)])
def test_the_distance_is_the_smallest_that_keeps_the_object_in_the_frame(size: tuple[int, int]) -> None:
    mesh = render.normalise(stool())
    settings = RenderSettings(views=20, size=size, focal=100.0)
    for camera in sample_cameras(settings, mesh.vertices, np.random.default_rng(0)):
        pixels, _ = camera.project(mesh.vertices)
        free = np.minimum(pixels + 0.5, np.array(size) - 0.5 - pixels).min()
        assert free >= MARGIN_PX - 1e-9
        if camera.t[2] > 2.0:
            assert free == pytest.approx(MARGIN_PX)


def test_cameras_are_drawn_from_the_ranges_and_a_distance_given_is_kept() -> None:
    settings = RenderSettings(views=200, azimuth=(30.0, 60.0), elevation=(-5.0, 40.0), distance=2.5, focal=77.0)
    cameras = sample_cameras(settings, box().vertices, np.random.default_rng(1))
    place = np.array([-camera.R.T @ camera.t for camera in cameras]) / 2.5
    azimuth, elevation = np.degrees(np.arctan2(place[:, 0], place[:, 2])), np.degrees(np.arcsin(place[:, 1]))
    assert 30 <= azimuth.min() < 32
    assert 58 < azimuth.max() <= 60
    assert -5 <= elevation.min() < -2
    assert 37 < elevation.max() <= 40
    assert {camera.K[0, 0] for camera in cameras} == {77.0}


def test_a_camera_inside_the_object_is_refused() -> None:
    with pytest.raises(InputError, match="inside the object"):
        sample_cameras(RenderSettings(distance=0.3), box().vertices, np.random.default_rng(0))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"views": 0}, "views is 0"),
        ({"size": (4, 64)}, "size is 4x64"),
        ({"azimuth": (90.0, 10.0)}, "azimuth"),
        ({"elevation": (-5.0, 91.0)}, "elevation"),
        ({"elevation": (float("nan"), 9.0)}, "elevation"),
        ({"distance": 0.0}, "distance"),
        ({"focal": float("inf")}, "focal"),
        ({"points": 300, "samples": 200}, "points is 300"),
    ],
)
def test_settings_without_sense_are_refused(change: dict[str, object], words: str) -> None:
    with pytest.raises(InputError, match=words):
        replace(RenderSettings(), **change)  # type: ignore[arg-type]


# Pictures


@pytest.mark.parametrize("focal", [60.0, 61.7, 61.3])
def test_the_mask_of_a_cube_seen_from_the_front_is_its_projected_front_face(focal: float) -> None:
    camera = render.look_at(0.0, 0.0, 2.0, (64, 48), focal)
    view = render_view(RayScene(box()), camera)
    half = focal * 0.5 / 1.5  # the front face, at depth 1.5
    across = [np.clip(half + 0.5 - np.abs(np.arange(n) - (n - 1) / 2), 0.0, 1.0) for n in (48, 64)]
    np.testing.assert_array_equal(view.mask > 0, np.outer(*across) > 0.5)
    assert set(np.unique(view.mask)) == {0, 255}


def test_the_area_of_a_sphere_is_that_of_its_outline() -> None:
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.5)
    camera = render.look_at(70.0, 25.0, 2.0, (128, 128), 200.0)
    view = render_view(RayScene(Mesh(np.array(ball.vertices), np.array(ball.faces, dtype=np.int64))), camera)
    radius = 200.0 * 0.5 / np.sqrt(2.0**2 - 0.5**2)  # the cone of tangents, cut by the image plane
    assert (view.mask > 0).sum() == pytest.approx(np.pi * radius**2, rel=0.01)
    centre = np.array(ndimage.center_of_mass(view.mask))
    np.testing.assert_allclose(centre, [63.5, 63.5], atol=0.05)


@pytest.mark.parametrize("model", ["perspective", "orthographic"])
def test_mask_and_projected_surface_agree_for_any_camera(model: str) -> None:
    rng = np.random.default_rng(2)
    mesh = render.normalise(stool())
    points = sample_surface(mesh.vertices, mesh.faces, 4000, rng)
    for _ in range(5):
        camera = render.look_at(rng.uniform(0, 360), rng.uniform(-40, 60), 2.5, (90, 70))
        K = np.array([[75.0, 6.0, 47.3], [0.0, 60.0, 32.1], [0.0, 0.0, 1.0]])
        if model == "orthographic":
            K[:2, :2] /= 2.0
            camera = replace(camera, t=np.array([0.1, 0.05, 0.0]))  # the object straddles the camera's plane
        camera = replace(camera, K=K, model=model)
        mask = render_view(RayScene(mesh), camera).mask
        pixels, _ = camera.project(points)
        assert inside(ndimage.binary_dilation(mask > 0, np.ones((3, 3))), pixels).mean() > 0.99
        # And nothing else is covered: every covered pixel has a projected point near it.
        hits = np.zeros(mask.shape, bool)
        columns, rows = np.rint(pixels).astype(int).T
        hits[rows, columns] = True
        near = ndimage.binary_dilation(hits, np.ones((5, 5)))
        assert not ((mask > 0) & ~near).any()


def test_a_shipped_like_view_holds_the_whole_object_and_its_target() -> None:
    rendered = render.render_mesh(stool(), replace(FAST, views=6, size=(64, 64)), np.random.default_rng(3))
    for view in rendered.views:
        edge = np.concatenate([view.mask[0], view.mask[-1], view.mask[:, 0], view.mask[:, -1]])
        assert not edge.any()
        assert view.mask.any()
        pixels, _ = view.camera.project(rendered.target.astype(np.float64))
        assert inside(ndimage.binary_dilation(view.mask > 0, np.ones((3, 3))), pixels).mean() > 0.99


def test_what_is_nearer_hides_what_is_behind() -> None:
    red, blue = [255, 0, 0], [0, 0, 255]
    mesh = joined(box((0.4, 0.4, 0.1), (0, 0, 0.3)), box((1, 1, 0.1), (0, 0, -0.3)))
    mesh = Mesh(mesh.vertices, mesh.faces, np.array([red] * 12 + [blue] * 12, dtype=np.uint8))
    front = render_view(RayScene(mesh), render.look_at(0.0, 0.0, 3.0, (33, 33), 40.0)).image
    back = render_view(RayScene(mesh), render.look_at(180.0, 0.0, 3.0, (33, 33), 40.0)).image
    assert front[16, 16, 0] > 50
    assert front[16, 16, 2] == 0
    assert back[16, 16, 2] > 50
    assert back[16, 16, 0] == 0
    assert (front[0, 0] == 255).all()


def test_an_object_out_of_sight_gives_an_empty_mask_on_white() -> None:
    camera = replace(render.look_at(0.0, 0.0, 2.0, (20, 20)), t=np.array([50.0, 0.0, 2.0]))
    view = render_view(RayScene(box()), camera)
    assert not view.mask.any()
    assert (view.image == 255).all()


def test_a_camera_inside_the_mesh_sees_it_all_around() -> None:
    camera = replace(render.look_at(0.0, 0.0, 2.0, (20, 20), 10.0), t=np.zeros(3))
    assert render_view(RayScene(box()), camera).mask.all()


def test_a_large_picture_is_cast_in_pieces_that_fit_together(monkeypatch: pytest.MonkeyPatch) -> None:
    camera = render.look_at(30.0, 20.0, 2.5, (700, 640))
    whole = render_view(RayScene(stool()), camera)
    calls = []
    cast = RayScene.cast

    def counted(self: RayScene, camera: Camera, columns: np.ndarray, rows: np.ndarray) -> dict[str, np.ndarray]:
        calls.append(len(rows) * len(columns))
        return cast(self, camera, columns, rows)

    monkeypatch.setattr(RayScene, "cast", counted)
    again = render_view(RayScene(stool()), camera)
    assert len(calls) > 1
    assert max(calls) <= RAYS_AT_ONCE
    small = render_view(RayScene(stool()), camera.resized(70, 64))
    np.testing.assert_array_equal(whole.image, again.image)
    shrunk = (whole.mask.reshape(64, 10, 70, 10) > 0).mean(axis=(1, 3)) > 0.5
    assert (shrunk != (small.mask > 0)).mean() < 0.01


# Ground truth


def test_samples_are_spread_by_area() -> None:
    settings = RenderSettings(samples=40000, points=1)
    points, _ = render.ground_truth(box((1.0, 0.5, 0.25)), settings, np.random.default_rng(4))
    areas = {0: 0.5 * 0.25, 1: 1.0 * 0.25, 2: 1.0 * 0.5}
    half = np.array([0.5, 0.25, 0.125])
    for axis, area in areas.items():
        on_side = np.isclose(np.abs(points[:, axis]), half[axis], atol=1e-12)
        assert on_side.mean() == pytest.approx(area / sum(areas.values()), abs=0.01)
    assert (np.abs(points) <= half + 1e-12).all()
    np.testing.assert_allclose(points.mean(axis=0), 0.0, atol=0.01)


def test_the_target_is_the_farthest_point_subset_of_the_samples() -> None:
    rendered = render.render_mesh(stool(), FAST, np.random.default_rng(6))
    assert rendered.samples.shape == (200, 3)
    assert rendered.target.shape == (50, 3)
    kept = farthest_point_sample(rendered.samples, 50)
    np.testing.assert_allclose(np.sort(rendered.target, axis=0), np.sort(rendered.samples[kept], axis=0), atol=1e-6)


def test_a_mesh_is_centred_and_scaled_whatever_no_face_uses() -> None:
    mesh = box((2.0, 4.0, 1.0), (1e6, -5.0, 3.0))
    stray = Mesh(np.vstack([[1e9, 0, 0], mesh.vertices]), mesh.faces + 1)
    vertices = render.normalise(stray).vertices
    np.testing.assert_allclose(vertices.min(axis=0), [-0.25, -0.5, -0.125], atol=1e-9)
    np.testing.assert_allclose(vertices.max(axis=0), [0.25, 0.5, 0.125], atol=1e-9)


# Folders


@pytest.fixture
def meshes(tmp_path: Path) -> Path:
    folder = tmp_path / "meshes"
    (folder / "chair").mkdir(parents=True)
    write_mesh(folder / "chair" / "a.ply", stool())
    write_mesh(folder / "chair" / "b.ply", box((1.0, 0.3, 0.5)))
    write_mesh(folder / "c.ply", box())
    return folder


def contents(folder: Path) -> dict[str, bytes]:
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def test_a_folder_is_rendered_into_the_documented_layout(meshes: Path, tmp_path: Path) -> None:
    seen: list[tuple[int, int, str]] = []
    summary = render_folder(meshes, tmp_path / "out", FAST, progress=lambda *about: seen.append(about))
    assert summary.written == ["c", "chair/a", "chair/b"]
    assert not summary.skipped
    assert not summary.failed
    assert seen == [(1, 3, "c"), (2, 3, "chair/a"), (3, 3, "chair/b")]
    assert sorted(path.name for path in (tmp_path / "out/chair/a").iterdir()) == sorted(
        [f"{i:03d}{end}" for i in range(3) for end in (".png", ".mask.png")]
        + ["cameras.json", "render.json", "target.ply", "target_200.ply"]
    )
    document = json.loads((tmp_path / "out/c/cameras.json").read_text())
    assert [(view["image"], view["mask"]) for view in document["views"]] == [
        (f"{i:03d}.png", f"{i:03d}.mask.png") for i in range(3)
    ]


def test_an_object_depends_on_the_seed_and_not_on_the_others(meshes: Path, tmp_path: Path) -> None:
    render_folder(meshes, tmp_path / "all", FAST, seed=1)
    (meshes / "c.ply").unlink()
    render_folder(meshes, tmp_path / "two", FAST, seed=1)
    render_folder(meshes, tmp_path / "other", FAST, seed=2)
    assert contents(tmp_path / "all/chair") == contents(tmp_path / "two/chair")
    assert contents(tmp_path / "all/chair")["a/target.ply"] != contents(tmp_path / "other/chair")["a/target.ply"]


def test_an_interrupted_run_leaves_only_whole_objects_and_goes_on(
    meshes: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    render_folder(meshes, tmp_path / "whole", FAST)
    calls = []

    def stopped(path: Path, *arguments: object, **options: object) -> None:
        calls.append(path)
        if len(calls) == 10:
            raise KeyboardInterrupt
        original(path, *arguments, **options)  # type: ignore[arg-type]

    original = rendered.write_image
    monkeypatch.setattr(rendered, "write_image", stopped)
    with pytest.raises(KeyboardInterrupt):
        render_folder(meshes, tmp_path / "out", FAST)
    monkeypatch.undo()
    left = list(contents(tmp_path / "out"))
    assert left
    assert all(name.startswith("c/") for name in left)
    summary = render_folder(meshes, tmp_path / "out", FAST)
    assert summary.skipped == ["c"]
    assert summary.written == ["chair/a", "chair/b"]
    assert contents(tmp_path / "out") == contents(tmp_path / "whole")


def stopped_by(number: signal.Signals, source: Path, output: Path) -> tuple[int, str]:
    """Start `tso render` and send it a signal while it writes an object; its exit status and stderr."""
    command = [sys.executable, "-m", "tso_cli", "render", str(source), "-o", str(output), *MANY]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) as process:
        deadline = time.monotonic() + 120
        while not list(output.glob("**/.*.partial/002.png")) and process.poll() is None and time.monotonic() < deadline:
            time.sleep(0.002)
        process.send_signal(number)
        _, told = process.communicate(timeout=60)
    return process.returncode, told


def hidden(folder: Path) -> list[str]:
    return [path.name for path in folder.rglob(".*")]


def test_a_killed_run_leaves_what_the_next_one_sweeps_away(meshes: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert stopped_by(signal.SIGKILL, meshes, out)[0] == -signal.SIGKILL
    assert any(name.endswith(".partial") for name in hidden(out))
    whole = [path.parent for path in out.glob("**/render.json") if not path.parent.name.startswith(".")]
    arguments = [str(meshes), "-o", str(out), *MANY]
    result = CliRunner().invoke(command, arguments, catch_exceptions=False)
    assert result.exit_code == 0
    assert hidden(out) == []
    assert sorted(path.parent.relative_to(out).as_posix() for path in out.glob("**/render.json")) == ["c", "chair/a", "chair/b"]
    assert (f"{len(whole)} rendered before, skipped" in result.stderr) == bool(whole)


def test_a_run_that_is_asked_to_end_cleans_up_as_after_ctrl_c(meshes: Path, tmp_path: Path) -> None:
    status, told = stopped_by(signal.SIGTERM, meshes, tmp_path / "out")
    assert status == 130
    assert told.splitlines()[-1] == "tso: error: interrupted"
    assert "Traceback" not in told
    assert hidden(tmp_path / "out") == []


def left_behind(out: Path, name: str) -> Path:
    folder = out / name
    folder.mkdir(parents=True)
    (folder / "000.png").write_bytes(b"half")
    return folder


def test_only_what_no_living_process_writes_of_these_objects_is_swept(meshes: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    stale = left_behind(out, ".c.0123abcd.partial")
    living = left_behind(out, ".c.89abcdef.partial")
    others = [left_behind(out, name) for name in (".other.0123abcd.partial", ".c.0123abcd.backup", ".c.partial")]
    (out / "chair").mkdir()
    (out / "chair" / ".a.0123abcd.partial").symlink_to(others[0])
    just_made = out / "chair" / ".b.0123abcd.partial"
    just_made.mkdir()
    lock = rendered._lock(living)
    assert lock is not None
    render_folder(meshes, out, FAST)
    assert not stale.exists()
    assert all(path.exists() for path in (living, *others, just_made))
    os.close(lock)
    os.utime(just_made, (0, 0))
    render_folder(meshes, out, FAST)
    assert not living.exists()
    assert not just_made.exists()
    assert all((path / "000.png").exists() for path in others)


def test_an_object_whose_replacement_was_killed_half_way_comes_back(meshes: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    render_folder(meshes, out, FAST)
    before = contents(out)
    (out / "c").rename(out / ".c.0123abcd.old")
    left_behind(out, ".c.0123abcd.partial")
    (out / "chair" / "a").rename(out / "chair" / ".a.0123abcd.old")
    render_folder(meshes / "chair", out / "chair", FAST)
    render_folder(meshes / "c.ply", out, FAST)
    assert contents(out) == before
    left_behind(out, ".c.0123abcd.old")
    render_folder(meshes, out, FAST)
    assert contents(out) == before


def test_an_object_is_locked_while_it_is_written(meshes: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out, write, seen = tmp_path / "out", rendered.write_image, []

    def swept(path: Path, *arguments: Any, **options: Any) -> None:
        write(path, *arguments, **options)
        rendered.sweep([out / "c"])
        seen.append(path.exists())

    monkeypatch.setattr(rendered, "write_image", swept)
    render_folder(meshes / "c.ply", out, FAST)
    render_folder(meshes / "c.ply", out, FAST, overwrite=True)
    assert seen == [True] * 12
    assert hidden(out) == []


def test_other_settings_are_not_mixed_into_a_folder_without_overwrite(meshes: Path, tmp_path: Path) -> None:
    render_folder(meshes, tmp_path / "out", FAST)
    before = contents(tmp_path / "out")
    with pytest.raises(InputError, match=r"views 3, now it is 2.*--overwrite"):
        render_folder(meshes, tmp_path / "out", replace(FAST, views=2))
    assert contents(tmp_path / "out") == before
    summary = render_folder(meshes, tmp_path / "out", replace(FAST, views=2), overwrite=True)
    assert len(summary.written) == 3
    assert not (tmp_path / "out/c/002.png").exists()
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"c", "chair"}


def test_a_folder_of_something_else_is_never_replaced(meshes: Path, tmp_path: Path) -> None:
    (tmp_path / "out/c").mkdir(parents=True)
    (tmp_path / "out/c/thesis.tex").write_text("years of work")
    for overwrite in (False, True):
        with pytest.raises(InputError, match="not an object"):
            render_folder(meshes, tmp_path / "out", FAST, overwrite=overwrite)
    assert contents(tmp_path / "out") == {"c/thesis.tex": b"years of work"}


def test_a_bad_mesh_among_good_ones_is_named_and_the_others_are_rendered(meshes: Path, tmp_path: Path) -> None:
    (meshes / "chair/broken.ply").write_text("ply\n")
    summary = render_folder(meshes, tmp_path / "out", FAST)
    assert len(summary.written) == 3
    assert list(summary.failed) == ["chair/broken"]
    assert "broken.ply" in summary.failed["chair/broken"]
    assert not (tmp_path / "out/chair/broken").exists()


def test_a_bad_mesh_alone_is_an_error_and_writes_nothing(tmp_path: Path) -> None:
    (tmp_path / "broken.ply").write_text("ply\n")
    with pytest.raises(InputError, match=r"broken\.ply"):
        render_folder(tmp_path / "broken.ply", tmp_path / "out", FAST)
    with pytest.raises(InputError, match="does not exist"):
        render_folder(tmp_path / "missing.ply", tmp_path / "out", FAST)
    assert not (tmp_path / "out").exists()


def test_names_that_would_collide_are_refused(meshes: Path, tmp_path: Path) -> None:
    (meshes / "c.stl").write_bytes(b"x")
    with pytest.raises(InputError, match="different names"):
        render_folder(meshes, tmp_path / "out", FAST)
    (meshes / "c.stl").rename(meshes / "chair.stl")
    with pytest.raises(InputError, match="rendered inside chair"):
        render_folder(meshes, tmp_path / "out", FAST)
    assert not (tmp_path / "out").exists()


def test_the_output_may_lie_inside_the_source(meshes: Path) -> None:
    first = render_folder(meshes, meshes / "out", FAST)
    again = render_folder(meshes, meshes / "out", FAST)
    assert again.skipped == first.written
    assert not again.written


def test_an_output_that_cannot_be_a_folder_is_refused(meshes: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    with pytest.raises(InputError, match="is a file"):
        render_folder(meshes, tmp_path / "file", FAST)
    with pytest.raises(InputError, match="does not exist"):
        render_folder(meshes, tmp_path / "no/such", FAST)


def test_without_open3d_one_line_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "open3d", None)
    with pytest.raises(TsoError, match=r"tso-cli\[render\].*libusb-1.0-0 libgl1 libegl1 libx11-6 libgomp1") as caught:
        RayScene(box())
    assert "\n" not in str(caught.value)


# The command


def test_the_command_prints_one_json_document_and_writes_what_can_be_read(meshes: Path, tmp_path: Path) -> None:
    arguments = f"{meshes} -o {tmp_path / 'out'} --views 2 --size 32x24 --samples 100 --points 40 --seed 5 --json"
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        result = CliRunner().invoke(command, arguments.split(), catch_exceptions=False)
    document = json.loads(result.stdout)
    assert document["written"] == ["c", "chair/a", "chair/b"]
    assert document["settings"]["size"] == [32, 24]
    data = open_rendered(tmp_path / "out")
    assert [item.target().shape for item in data.objects if item.target] == [(40, 3)] * 3
    assert data.objects[0].views[0].load()[0].shape == (24, 32, 3)


def test_the_command_says_what_it_skipped_and_what_failed(meshes: Path, tmp_path: Path) -> None:
    arguments = [
        str(meshes),
        "-o",
        str(tmp_path / "out"),
        *["--views", "1", "--size", "16", "--samples", "60", "--points", "20"],
    ]
    assert CliRunner().invoke(command, arguments).exit_code == 0
    (meshes / "d.ply").write_text("ply\n")
    result = CliRunner().invoke(command, arguments)
    assert isinstance(result.exception, InputError)
    assert "1 mesh" in str(result.exception)
    assert "3 rendered before, skipped" in result.stderr
    assert "d.ply" in result.stderr


def test_the_command_refuses_a_size_that_is_none(meshes: Path, tmp_path: Path) -> None:
    result = CliRunner().invoke(command, [str(meshes), "-o", str(tmp_path / "out"), "--size", "wide"])
    assert result.exit_code == 2
    assert "128x96" in result.stderr
