"""What explains a misfit: a right cloud under a wrong camera or mask stays, and the cause is named.

The masks are rendered from the true meshes. Every camera is right but for what a test says.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import binary_dilation, binary_erosion

from tests.scenes import about, example, small
from tso_cli import RefineConfig, View, refine
from tso_cli.cloud.cloud import Cloud
from tso_cli.pose.causes import find_move
from tso_cli.pose.placement import ASPECT, FOCAL, GROWTH, PRINCIPAL
from tso_cli.refinement.scene import as_scene

SHAPES = {name: example(name) for name in ("chair", "car", "airplane")}
EVERY_SHAPE = pytest.mark.parametrize("shape", SHAPES.values(), ids=SHAPES)


def _view(shape, change=None) -> View:
    """The rendered view of a shipped shape, 256 pixels wide, with K after the ``change``."""
    if change is None:
        return shape.view
    K = shape.camera.K.copy()
    change(K)
    return replace(shape.view, camera=replace(shape.camera, K=K))


def _zoomed(K):
    K[[0, 1], [0, 1]] *= 1.1


def _squashed(K):
    K[1, 1] *= 1.18


def _cropped(K):
    K[:2, 2] += [18.0, -12.0]


def _causes_of(points, view):
    move = find_move(Cloud(points, "points").controlled().body, [view])
    assert move.kind == "nothing"
    return {cause.name: cause for cause in move.causes}


@EVERY_SHAPE
@pytest.mark.parametrize(
    ("change", "name", "unknown", "mended"),
    [
        (_zoomed, "focal-length", FOCAL, [np.log(1.0 / 1.1)]),
        (_squashed, "aspect", ASPECT, [np.log(1.0 / 1.18)]),
        (_cropped, "principal-point", PRINCIPAL, [-18.0 / 256.0, 12.0 / 256.0]),
    ],
    ids=["focal length", "squashed", "cropped"],
)
def test_a_right_cloud_before_a_wrong_camera_stays_and_the_camera_is_named(
    shape, change, name, unknown, mended
):
    view = _view(shape, change)
    cause = _causes_of(shape.target, view)[name]
    np.testing.assert_allclose(np.atleast_1d(cause.change[unknown]), mended, atol=0.03)
    result = refine(shape.target, view)
    np.testing.assert_array_equal(result.points, shape.target)
    assert result.trust.verdict == "doubtful"


@EVERY_SHAPE
@pytest.mark.parametrize("pixels", [5, -4])
def test_a_mask_that_is_grown_or_shrunk_on_all_sides_bends_no_right_cloud(shape, pixels):
    view = _view(shape)
    change = binary_dilation if pixels > 0 else binary_erosion
    mask = change(view.mask > 0.5, np.ones((3, 3)), iterations=abs(pixels))
    view = replace(view, mask=np.float32(mask))
    # The edge of a cloud lies inside that of its surface.
    cause = _causes_of(shape.target, view)["outline"]
    assert cause.change[GROWTH] == pytest.approx(pixels, abs=2.0)
    np.testing.assert_array_equal(refine(shape.target, view).points, shape.target)


@EVERY_SHAPE
def test_another_shape_is_explained_by_no_camera_and_no_mask(shape):
    for change in (None, _zoomed, _squashed):
        assert _causes_of(shape.points, _view(shape, change)) == {}


@EVERY_SHAPE
def test_a_right_cloud_in_its_place_fits_and_nothing_is_done(shape):
    view = _view(shape)
    assert find_move(Cloud(shape.target, "points").controlled().body, [view]).fits
    result = refine(shape.target, view)
    assert (result.trust.verdict, result.fit.stop_reason) == ("left", "fits")
    np.testing.assert_array_equal(result.points, shape.target)


@EVERY_SHAPE
def test_a_cloud_that_is_turned_is_turned_back_as_no_camera_explains_it(shape):
    view = _view(shape)
    wrong = shape.target @ about("y", 7.0).T @ about("x", 5.0).T
    move = find_move(Cloud(wrong, "points").controlled().body, [view])
    assert move.kind == "pose"
    assert shape.error(move.apply(wrong)) < 0.6 * shape.error(wrong)


def test_who_asks_for_the_shape_alone_gets_no_camera_named():
    chair = SHAPES["chair"]
    result = refine(chair.target, _view(chair, _zoomed), config=RefineConfig(move="shape"))
    assert "focal-length" not in [finding.name for finding in result.findings]


# Small masks, whose outline is a pixel too far out


def _stretched(shape, axis: int, factor: float) -> np.ndarray:
    return shape.target * np.where(np.arange(3) == axis, factor, 1.0)


STRETCHES = pytest.mark.parametrize("factor", [1.1, 1.15])
AXES = pytest.mark.parametrize("axis", range(3), ids="xyz")


def _growth(points, view) -> float:
    """Pixels by which the mask seems to have grown, as a cause or beside other proportions."""
    move = find_move(Cloud(points, "points").controlled().body, [view])
    named = [cause.change[GROWTH] for cause in move.causes if cause.name == "outline"]
    return named[0] if named else move.growth


@AXES
@STRETCHES
@pytest.mark.parametrize("shape", [SHAPES["chair"], SHAPES["airplane"]], ids=["chair", "airplane"])
def test_the_growth_of_a_small_mask_is_told_from_a_stretch(shape, axis, factor):
    growth = _growth(_stretched(shape, axis, factor), small(shape, 48, grown=1))
    assert growth == pytest.approx(1.0, abs=0.35)


@AXES
@STRETCHES
@pytest.mark.parametrize(
    ("name", "pixels"), [("car", 48), ("chair", 24), ("airplane", 24)], ids=str
)
def test_of_a_growth_that_looks_like_a_stretch_a_part_is_found(name, pixels, axis, factor):
    """A compact shape that is larger on all sides, or one of few pixels, has no thin part."""
    shape = SHAPES[name]
    growth = _growth(_stretched(shape, axis, factor), small(shape, pixels, grown=1))
    assert 0.15 < growth < 1.0


@EVERY_SHAPE
@AXES
@STRETCHES
@pytest.mark.parametrize("pixels", [24, 48, 128])
def test_a_stretch_before_an_exact_mask_is_hardly_taken_for_a_growth(shape, axis, factor, pixels):
    view, points = small(shape, pixels), _stretched(shape, axis, factor)
    growth = _growth(points, view)
    assert abs(growth) < 0.3
    if pixels == 128:
        assert as_scene(points, view).with_outlines(growth).views == (view,)


def test_shapes_get_better_if_a_grown_mask_is_corrected(monkeypatch):
    """In the mean: what one of them gains depends on the last bits of the processor's sums."""
    cases = [("chair", 24), ("airplane", 24), ("chair", 48), ("car", 48), ("airplane", 48)]
    ratios = []
    for name, pixels in cases:
        shape = SHAPES[name]
        points, view = _stretched(shape, 0, 1.12), small(shape, pixels, grown=1)
        corrected = refine(points, view)
        with monkeypatch.context() as patch:
            patch.setattr(
                "tso_cli.refinement.run.find_move",
                lambda *given: replace(find_move(*given), growth=0.0),
            )
            as_given = refine(points, view)
        ratios.append(shape.error(corrected.points) / shape.error(as_given.points))
        assert "outline-corrected" not in [finding.name for finding in as_given.findings]
    assert np.exp(np.log(ratios).mean()) < 0.9, ratios


def test_a_correction_by_half_a_pixel_or_more_is_a_finding():
    chair = SHAPES["chair"]
    result = refine(_stretched(chair, 0, 1.12), small(chair, 48, grown=1))
    (finding,) = (one for one in result.findings if one.name == "outline-corrected")
    assert finding.values["how"] == "large"
    assert finding.values["pixels"] == pytest.approx(1.0, abs=0.35)
    assert not finding.suspicious
