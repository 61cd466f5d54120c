"""The study of the three variants: what it compares, and what it concludes."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from tso_cli.evaluation.metrics import chamfer
from tso_cli.geometry.points import normalise_longest_side, sample_surface
from tso_cli.geometry.view import View
from tso_cli.io.meshes import Mesh
from tso_cli.refinement import RefineConfig
from tso_cli.render.rays import RayScene
from tso_cli.render.settings import RenderSettings
from tso_cli.render.viewpoints import look_at
from tso_cli.scene.network import network_scene
from tso_lab.studies.shapes import Shape, see, view_aligned_network
from tso_lab.studies.variants import VARIANTS, conclude, distances, refine_view, visible_points

from .studying import MESHES, holding, thin_checkpoint

COP = Shape("car/qreal_Cop", MESHES / "car" / "qreal_Cop.ply")


@pytest.fixture
def checkpoint(tmp_path, monkeypatch):
    return thin_checkpoint(tmp_path, monkeypatch, 64)


def square(z: float, half: float) -> tuple[np.ndarray, np.ndarray]:
    corners = np.array([[-half, -half, z], [half, -half, z], [half, half, z], [-half, half, z]])
    return corners, np.array([[0, 1, 2], [0, 2, 3]])


def test_a_plate_hides_what_lies_behind_it_and_nothing_beside_it():
    (near, faces), (far, _) = square(0.2, 0.25), square(-0.2, 0.5)
    scene = RayScene(Mesh(np.concatenate([near, far]), np.concatenate([faces, faces + 4]), None))
    camera = look_at(0.0, 0.0, 2.0, (64, 64))
    x, y = np.meshgrid(np.linspace(-0.49, 0.49, 15), np.linspace(-0.49, 0.49, 15))
    behind = np.stack([x.ravel(), y.ravel(), np.full(x.size, -0.2)], axis=1)
    # the camera stands at z = 2: the near plate's shadow on the far one is larger by 2.2 / 1.8
    shadow = np.abs(behind[:, :2]).max(1) < 0.25 * 2.2 / 1.8
    assert 20 < shadow.sum() < 200
    np.testing.assert_array_equal(visible_points(scene, behind, camera), ~shadow)
    assert visible_points(scene, near * 0.99 + [0.0, 0.0, 0.002], camera).all()


def test_on_a_convex_body_a_point_is_seen_exactly_where_its_surface_faces_the_camera():
    body = trimesh.creation.box(extents=(1.0, 0.6, 0.8))
    scene = RayScene(Mesh(np.asarray(body.vertices), np.asarray(body.faces, dtype=np.int64), None))
    points = sample_surface(body.vertices, body.faces, 500, np.random.default_rng(0))
    camera = look_at(33.0, 25.0, 2.2, (64, 64))
    centre = -camera.R.T @ camera.t
    axis = np.abs(np.abs(points) / [0.5, 0.3, 0.4] - 1.0).argmin(1)
    normals = np.sign(points) * np.eye(3)[axis]
    towards = centre - points
    cosine = (normals * towards).sum(1) / np.linalg.norm(towards, axis=1)
    clear = np.abs(cosine) > 0.02
    # within the tolerance of an edge the far side still counts as seen
    inner = np.sort(np.abs(np.abs(points) - [0.5, 0.3, 0.4]), axis=1)[:, 1] > 0.01
    keep = clear & inner
    np.testing.assert_array_equal(visible_points(scene, points, camera)[keep], cosine[keep] > 0.0)


def test_visible_and_occluded_points_make_up_the_forward_distance():
    rng = np.random.default_rng(0)
    prediction, target = (normalise_longest_side(rng.normal(size=(count, 3))) for count in (20, 30))
    sees = np.arange(30) < 12
    found = distances(prediction, target, sees)
    assert found["forward"] == pytest.approx((12 * found["visible"] + 18 * found["occluded"]) / 30)
    nearest = np.square(target[:, None] - prediction[None]).sum(2).min(1)
    assert found["visible"] == pytest.approx(nearest[:12].mean())
    assert distances(prediction, target, np.ones(30, dtype=bool))["occluded"] is None


def test_a_prediction_of_another_scale_and_place_is_at_distance_zero():
    target = np.random.default_rng(0).normal(size=(30, 3))
    found = distances(2.0 * target + 0.1, target, np.arange(30) < 12)
    assert list(found.values()) == pytest.approx([0.0] * 4, abs=1e-20)


@pytest.mark.slow
def test_every_variant_moves_the_prediction_and_is_compared_as_eval_does_under_the_papers_protocol(
    checkpoint,
):
    seen = see(COP, RenderSettings(views=1, size=(128, 128)), 0)
    network, about = view_aligned_network(checkpoint)
    case = refine_view(COP, seen, 0, network, about, RefineConfig(steps=2, preset="paper"))
    assert len({case["capnet"][name]["forward"] for name in ("before", *VARIANTS)}) == 4
    picture = seen.views[0]
    scene = network_scene(
        picture.image, View(picture.mask / np.float32(255.0), picture.camera), network, about
    )
    target = (seen.target @ picture.camera.R.T) * [1.0, -1.0, -1.0]
    expected = chamfer(normalise_longest_side(scene.points), normalise_longest_side(target))
    before = case["capnet"]["before"]
    assert (before["forward"], before["backward"]) == pytest.approx(
        (expected.forward, expected.backward), rel=1e-5
    )


def case_of(category: str, before: float, after: dict[str, float], occluded: float = 1.0) -> dict:
    """A case with all distances in one figure."""

    def cloud(value: float, hidden: float) -> dict:
        return {"forward": value / 2, "backward": value / 2, "visible": value, "occluded": hidden}

    found = {
        "before": cloud(before, 1.0),
        **{name: cloud(value, occluded) for name, value in after.items()},
    }
    return {
        "category": category,
        "shape": f"{category}/{before}",
        "capnet": found,
        "iou": {"before": 0.5, "encoder": 0.51, "encoder-decoder": 0.6, "points": 0.7},
        "seconds": dict.fromkeys(VARIANTS, 1.0),
    }


def test_the_summary_tells_the_ratio_of_means_from_the_cases_own():
    cases = [
        case_of("car", 1.0, {"encoder": 0.5, "encoder-decoder": 1.0, "points": 1.0}),
        case_of("car", 9.0, {"encoder": 9.9, "encoder-decoder": 9.0, "points": 9.0}),
        case_of("car", 2.0, {"encoder": 1.6, "encoder-decoder": 2.0, "points": 2.0}),
    ]
    summary = conclude(cases)["summary"]
    found = summary["car"]["capnet"]["encoder"]
    assert found["ratio_of_means"] == pytest.approx(1.0)
    assert [found["mean_ratio"], found["median_ratio"]] == pytest.approx([0.8, 0.8])
    assert (found["worst_ratio"], found["worse"]) == (pytest.approx(1.1), 1)
    assert summary["all"] == summary["car"]


GAINS = {"encoder": 0.95, "encoder-decoder": 0.94, "points": 0.97}


def test_a_claim_holds_only_where_the_figures_say_so():
    def answers(*cases):
        return conclude(list(cases))["claims"]

    assert holding(conclude([case_of("car", 1.0, GAINS)])) == [True, True, True, True, False]
    occluded_lost = answers(case_of("car", 1.0, GAINS, occluded=1.2))[2]
    assert not occluded_lost["holds"]
    assert occluded_lost["found"].endswith("; not on car, all")
    # A mean over categories hides one that fails.
    cars = [case_of("car", 9.0 + i, GAINS | {"encoder": 8.0 + i}) for i in range(9)]
    one_fails = answers(*cars, case_of("chair", 1.0, GAINS | {"encoder": 1.1}))[0]
    assert not one_fails["holds"]
    assert one_fails["found"].endswith("; not on chair")


def test_a_gain_that_depends_on_the_choice_of_shapes_does_not_count():
    # On average a gain of 1 %, but of shapes that gain or lose 20 %.
    cases = [
        case_of("car", 1.0 + 0.001 * i, GAINS | {"encoder": 0.79 if i % 2 else 1.19})
        for i in range(12)
    ]
    record = conclude(cases)
    summary = record["summary"]
    low, high = summary["all"]["capnet"]["encoder"]["interval"]
    assert low < summary["all"]["capnet"]["encoder"]["ratio_of_means"] < 1.0 < high
    assert not holding(record)[0]
    assert 0.93 < summary["all"]["capnet"]["encoder-decoder"]["interval"][1] < 0.95
    # The interval is over shapes and not over their views.
    assert conclude(cases * 5)["summary"]["all"]["capnet"]["encoder"]["interval"] == pytest.approx(
        [low, high]
    )
