"""Batches: frames and cameras, random draws, augmentation, backgrounds, replaced unusable data."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from tests.corruption import assert_refused
from tso_cli import Camera, InputError
from tso_cli.datasets.opening import open_dataset
from tso_cli.geometry.camera import CANONICAL_ROTATION
from tso_cli.io.images import write_image
from tso_cli.io.shipped import example_meshes
from tso_cli.train.backgrounds import Backgrounds
from tso_cli.train.batches import Draw, Drawing, assemble, draw_batch, recoloured
from tso_cli.train.data import TrainingData
from tso_cli.train.sources import from_meshes, shipped_examples

from ..training import make_objects

# Frames and cameras


def fills_its_masks(batch):
    """Whether every target point falls, within a pixel, into every supervising mask."""
    for b, target in enumerate(batch.targets):
        for v in range(batch.masks.shape[1]):
            pixels, depth = Camera(batch.K[b, v], batch.R[b, v], batch.t[b, v], 64, 64).project(
                target.astype(np.float64)
            )
            column, row = np.rint(pixels).astype(int).T
            if (
                depth.min() <= 0.0
                or not ndimage.binary_dilation(batch.masks[b, v] > 0.2)[row, column].all()
            ):
                return False
    return True


@pytest.mark.parametrize("frame", ["view", "canonical"])
def test_true_points_in_the_frame_of_the_prediction_fill_the_supervising_masks(data, frame):
    assert fills_its_masks(assemble(data, [Draw(0, 1, (0, 2, 3)), Draw(2, 0, (0, 1, 3))], frame))


def test_a_mirrored_object_fills_its_mirrored_masks(data):
    plain, mirrored = (
        assemble(data, [Draw(0, 1, (0, 2, 3), mirror)], "view") for mirror in (False, True)
    )
    np.testing.assert_allclose(
        mirrored.targets[0], plain.targets[0] * np.float32([-1, 1, 1]), atol=1e-6
    )
    np.testing.assert_array_equal(mirrored.images[0], plain.images[0, :, :, ::-1])
    np.testing.assert_allclose(np.linalg.det(mirrored.R), 1.0)
    assert fills_its_masks(mirrored)
    # The object is not symmetric: mirrored points do not fill the masks as they were.
    assert not fills_its_masks(replace(plain, targets=mirrored.targets))


def test_a_view_aligned_batch_has_the_axes_and_the_crop_of_its_picture(data):
    batch = assemble(data, [Draw(1, 2)], "view")
    in_camera = data.target(1) @ data.objects[1].views[2].camera.R.T
    np.testing.assert_allclose(batch.targets[0] @ CANONICAL_ROTATION.T, in_camera, atol=1e-6)
    np.testing.assert_array_equal(batch.images, data.prepared(1, 2).image[None])


def test_a_training_set_with_orthographic_cameras_is_refused():
    (item,) = make_objects(count=1, views=1)
    orthographic = replace(
        item.views[0], camera=replace(item.views[0].camera, model="orthographic")
    )
    assert_refused(
        "orthographic, expected perspective",
        TrainingData,
        [replace(item, views=[orthographic])],
        "one",
    )


# Random draws


def test_every_object_comes_once_in_an_epoch(data):
    for epoch in range(4):
        targets = [
            draw_batch(data, Drawing(5, 1, "canonical"), epoch * 3 + i).targets[0] for i in range(3)
        ]
        assert len({cloud.tobytes() for cloud in targets}) == 3


def test_a_batch_depends_on_seed_and_step_alone(data):
    def rotations(source, seed, step, size=2):
        return draw_batch(source, Drawing(seed, size, "view", 2), step).R.tobytes()

    assert rotations(data, 1, 4) == rotations(data, 1, 4)
    assert len({rotations(data, seed, step) for seed, step in ((1, 4), (2, 4), (1, 5))}) > 1
    single = TrainingData(data.objects[:1], "one box")
    assert len({rotations(single, 1, step, 1) for step in range(12)}) > 1


def test_a_balanced_draw_takes_a_rare_category_as_often_as_a_common_one():
    data = TrainingData([*make_objects(5, 1), *make_objects(1, 1, "crate")], "boxes and a crate")
    drawing = Drawing(0, 4, "canonical", balance=True)
    drawn = Counter(
        name for step in range(5) for name in draw_batch(data, drawing, step).categories
    )
    assert drawn == {"box": 10, "crate": 10}


def test_processes_share_a_batch_without_overlap(data):
    drawing = Drawing(3, 4, "view", views=2, augment=True)
    whole = draw_batch(data, drawing, 7)
    parts = [draw_batch(data, drawing, 7, (rank, 2)) for rank in (0, 1)]
    np.testing.assert_array_equal(whole.images[0::2], parts[0].images)
    np.testing.assert_array_equal(whole.masks[1::2], parts[1].masks)


def test_augmentation_mirrors_half_of_the_pictures_in_the_view_frame_alone(data):
    def same_targets(frame, step):
        plain, augmented = (
            draw_batch(data, Drawing(0, 1, frame, augment=on), step).targets[0]
            for on in (False, True)
        )
        return np.allclose(plain, augmented)

    assert 10 < sum(same_targets("view", step) for step in range(40)) < 30
    assert all(same_targets("canonical", step) for step in range(5))


def test_recolouring_changes_the_object_and_not_its_surroundings(data):
    picture = data.prepared(0, 0)
    changed = recoloured(picture, np.random.default_rng(0))
    change = np.abs(changed - picture.image)
    assert not change[:, picture.mask == 0.0].any()
    assert change[:, picture.mask == 1.0].mean() > 0.01
    assert changed.min() >= 0.0
    assert changed.max() <= 1.0


# Unusable pictures and points


def failing(message):
    def load():
        raise InputError(message)

    return load


def broken(item, *chosen):
    """``item`` with pictures that cannot be read: the chosen ones, or all."""
    views = list(item.views)
    for i in chosen or range(len(views)):
        views[i] = replace(
            views[i], load=failing(f"{views[i].name}.png: truncated, expected a picture")
        )
    return replace(item, views=views)


def test_an_unreadable_picture_is_warned_of_once_and_replaced():
    first, second = make_objects(2, 3)
    objects = [broken(first, 0), second]
    data = TrainingData(objects, "boxes")
    with pytest.warns(
        UserWarning, match="view 0.png: truncated, expected a picture; left out"
    ) as warned:
        replaced = assemble(data, [Draw(0, 0, (0, 2))], "view")
    usable = assemble(data, [Draw(0, 1, (1, 2))], "view")
    np.testing.assert_array_equal(replaced.images, usable.images)
    np.testing.assert_array_equal(replaced.masks, usable.masks)
    assert len(warned) == 1
    assert list(data.unusable) == ["box0 view 0"]
    assert_refused(
        "truncated", assemble, TrainingData(objects, "boxes", strict=True), [Draw(0, 0)], "view"
    )


def test_an_object_with_unreadable_points_is_warned_of_once_and_replaced():
    first, second = make_objects(2)
    objects = [
        replace(first, target=failing("target.ply: ends after 6 of 1024 rows, expected all")),
        second,
    ]
    data = TrainingData(objects, "boxes")
    with pytest.warns(UserWarning, match="target.ply: ends after 6 of 1024 rows") as warned:
        replaced = assemble(data, [Draw(0, 1), Draw(0, 2)], "view")
    assert len(warned) == 1
    assert list(data.unusable) == ["box0"]
    np.testing.assert_array_equal(
        replaced.images, assemble(data, [Draw(1, 1), Draw(1, 2)], "view").images
    )
    # Its pictures still serve where no points are needed.
    masks = assemble(data, [Draw(0, 1)], "view", targets=False)
    np.testing.assert_array_equal(masks.images[0], data.prepared(0, 1).image)
    assert_refused(
        "ends after 6", assemble, TrainingData(objects, "boxes", strict=True), [Draw(0, 0)], "view"
    )


def test_ten_unusable_pictures_are_warned_of_and_all_are_listed():
    objects = [broken(item) for item in make_objects(5, 4)]
    data = TrainingData(objects, "boxes")
    with pytest.warns(UserWarning, match="left out") as warned:
        assert_refused(
            "no picture can be used; the first: box1 view 1.png",
            assemble,
            data,
            [Draw(1, 1)],
            "view",
        )
    assert len(warned) == 10
    assert len(data.unusable) == 20


# Backgrounds


def test_the_object_is_composited_on_its_background():
    data = TrainingData(
        make_objects(1), "box", background="keep", backgrounds=Backgrounds("textures")
    )
    draws = [
        Draw(0, 0, background_seed=1),
        Draw(0, 0, background_seed=2),
        Draw(0, 0, mirror=True, background_seed=1),
    ]
    first, second, mirrored = assemble(data, draws, "view").images
    picture = data.prepared(0, 0)
    inside, outside = picture.mask == 1.0, picture.mask == 0.0
    for image in (first, second, mirrored[:, :, ::-1]):
        np.testing.assert_allclose(image[:, inside], picture.image[:, inside], atol=1e-6)
        assert image[:, outside].std() > 0.01
    assert np.abs(first - second)[:, outside].mean() > 0.05
    message, textures = "background 'black', expected 'keep'", Backgrounds("textures")
    assert_refused(message, TrainingData, make_objects(1), "box", backgrounds=textures)


def test_backgrounds_are_crops_of_photos_and_an_unreadable_one_is_replaced_with_one_warning(
    tmp_path,
):
    (tmp_path / "empty").mkdir()
    for name, message in (
        ("empty", "holds no picture"),
        ("none", "not a folder, expected a folder of photos .*, or 'textures'"),
    ):
        assert_refused(message, Backgrounds, str(tmp_path / name))
    write_image(tmp_path / "red.png", np.full((40, 90, 3), (255, 0, 0), np.uint8))
    (tmp_path / "broken.png").write_bytes(b"no picture")
    backgrounds = Backgrounds(str(tmp_path))
    with pytest.warns(UserWarning, match="broken.png: is not a readable image") as warned:
        crops = np.stack([backgrounds.sample(np.random.default_rng(seed)) for seed in range(9)])
    np.testing.assert_allclose(
        crops, np.broadcast_to([[[1.0]], [[0.0]], [[0.0]]], (9, 3, 64, 64)), atol=1e-6
    )
    assert len(warned) == 1
    assert list(backgrounds.unusable) == [str(tmp_path / "broken.png")]
    (tmp_path / "red.png").unlink()
    draw = np.random.default_rng(0)
    assert_refused(
        "broken.png: is not a readable image", Backgrounds(str(tmp_path), strict=True).sample, draw
    )
    with pytest.warns(UserWarning, match="broken.png"):
        assert_refused(
            "no photo can be used; the first: .*broken.png", Backgrounds(str(tmp_path)).sample, draw
        )


# Sources


def test_the_fingerprint_changes_with_the_pictures_of_the_same_objects():
    def dark(view):
        image, mask = view.load()
        return replace(view, load=lambda: (image // 2, mask))

    first, second = make_objects(2)
    changed = replace(second, views=[dark(second.views[0]), *second.views[1:]])
    objects = [first, second], make_objects(2), [first, changed]
    one, same, other = (TrainingData(items, "two").fingerprint() for items in objects)
    assert one == same != other


def test_a_rendered_folder_gives_the_same_batches_as_its_pictures_in_memory(folder):
    sources = open_dataset(folder).objects, make_objects(2)
    read, in_memory = (
        draw_batch(TrainingData(objects, "boxes"), Drawing(0, 2, "view", 2), 0)
        for objects in sources
    )
    for name in ("images", "masks", "K", "targets"):
        np.testing.assert_allclose(
            getattr(read, name), getattr(in_memory, name), atol=1e-6, rtol=1e-7
        )


def test_the_shipped_meshes_and_examples_are_training_data():
    pytest.importorskip("open3d")
    meshes = example_meshes()
    assert {path.parent.name for path in meshes} == {"airplane", "car", "chair"}
    one, same = (from_meshes(meshes[:2], "two", views=2) for _ in range(2))
    assert one.fingerprint() == same.fingerprint()
    unseen = shipped_examples()
    assert [item.name for item in unseen.objects] == ["chair", "car", "airplane"]
    assert unseen.evaluable(3) == [0, 1, 2]
