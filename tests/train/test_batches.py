"""What a step of training sees: mirrored, recoloured and balanced draws, shares of processes, unusable pictures."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from tso_cli.datasets.items import ViewItem
from tso_cli.errors import InputError
from tso_cli.geometry.camera import Camera
from tso_cli.io.images import write_image
from tso_cli.train.backgrounds import Backgrounds
from tso_cli.train.batches import Batch, Draw, Drawing, assemble, draw_batch, recoloured
from tso_cli.train.data import TrainingData
from tso_cli.train.losses import mask_loss, mask_loss_by_category

from ..training import make_objects


@pytest.fixture(scope="module")
def data() -> TrainingData:
    return TrainingData(make_objects(), "three boxes")


def fills_its_masks(batch: Batch) -> bool:
    """Whether every target point falls, within a pixel, into every supervising mask."""
    for b, target in enumerate(batch.targets):
        for v in range(batch.masks.shape[1]):
            pixels, depth = Camera(batch.K[b, v], batch.R[b, v], batch.t[b, v], 64, 64).project(target.astype(np.float64))
            column, row = np.rint(pixels).astype(int).T
            mask = np.pad(batch.masks[b, v] > 0.2, 1)
            near = mask[1:-1, 1:-1] | mask[:-2, 1:-1] | mask[2:, 1:-1] | mask[1:-1, :-2] | mask[1:-1, 2:]
            if depth.min() <= 0.0 or not near[row, column].all():
                return False
    return True


def test_a_mirrored_object_fills_its_mirrored_masks_from_every_side(data: TrainingData) -> None:
    plain = assemble(data, [Draw(0, 1, (0, 2, 3))], "view")
    mirrored = assemble(data, [Draw(0, 1, (0, 2, 3), mirror=True)], "view")
    np.testing.assert_allclose(mirrored.targets[0], plain.targets[0] * np.float32([-1, 1, 1]), atol=1e-6)
    np.testing.assert_array_equal(mirrored.images[0], plain.images[0, :, :, ::-1])
    np.testing.assert_allclose(np.linalg.det(mirrored.R), 1.0)
    assert fills_its_masks(plain) and fills_its_masks(mirrored)
    # The mirrored points do not fill the masks as they were: the object is not its own mirror image.
    assert not fills_its_masks(replace(plain, targets=mirrored.targets))


def test_recolouring_leaves_the_outline_and_what_is_around_it(data: TrainingData) -> None:
    picture = data.prepared(0, 0)
    changed = recoloured(picture, np.random.default_rng(0))
    outside = picture.mask == 0.0
    np.testing.assert_array_equal(changed[:, outside], picture.image[:, outside])
    assert np.abs(changed - picture.image)[:, picture.mask == 1.0].mean() > 0.01
    assert changed.min() >= 0.0 and changed.max() <= 1.0


def test_augmentation_mirrors_half_of_the_pictures_in_the_view_frame_alone(data: TrainingData) -> None:
    still = [draw_batch(data, Drawing(0, 1, "view"), step) for step in range(40)]
    moved = [draw_batch(data, Drawing(0, 1, "view", augment=True), step) for step in range(40)]
    flipped = sum(not np.allclose(a.targets[0], b.targets[0]) for a, b in zip(still, moved, strict=True))
    assert 10 < flipped < 30
    for step in range(5):
        canonical = [draw_batch(data, Drawing(0, 1, "canonical", augment=yes), step).targets[0] for yes in (False, True)]
        np.testing.assert_array_equal(*canonical)


def test_a_balanced_draw_sees_a_rare_category_as_often_as_a_common_one() -> None:
    far = np.full((8, 3), 9.0, np.float32)
    objects = [*make_objects(5, 1), replace(make_objects(1, 1, "crate")[0], target=lambda: far)]
    data = TrainingData(objects, "boxes and a crate")
    seen: Counter[bool] = Counter()
    for step in range(5):
        batch = draw_batch(data, Drawing(0, 4, "canonical", balance=True), step)
        seen.update(bool((points > 5.0).all()) for points in batch.targets)
    assert seen == {True: 10, False: 10}


def test_processes_share_a_batch_without_overlap(data: TrainingData) -> None:
    drawing = Drawing(3, 4, "view", views=2, augment=True)
    whole = draw_batch(data, drawing, 7)
    shares = [draw_batch(data, drawing, 7, (rank, 2)) for rank in (0, 1)]
    np.testing.assert_array_equal(whole.images[0::2], shares[0].images)
    np.testing.assert_array_equal(whole.masks[1::2], shares[1].masks)


def broken(item: ViewItem) -> ViewItem:
    def load() -> tuple[np.ndarray, np.ndarray]:
        raise InputError(f"{item.name}.png: truncated, expected a picture")

    return ViewItem(item.name, item.camera, load)


def test_a_picture_that_cannot_be_read_is_named_once_and_another_takes_its_place() -> None:
    objects = make_objects(2, 3)
    objects[0] = replace(objects[0], views=[broken(objects[0].views[0]), *objects[0].views[1:]])
    data = TrainingData(objects, "boxes")
    with pytest.warns(UserWarning, match="view 0.png: truncated, expected a picture; left out"):
        replaced = assemble(data, [Draw(0, 0, (0, 2))], "view")
    good = assemble(data, [Draw(0, 1, (1, 2))], "view")
    np.testing.assert_array_equal(replaced.images, good.images)
    np.testing.assert_array_equal(replaced.masks, good.masks)
    assert list(data.unusable) == ["box0 view 0"]
    strict = TrainingData(objects, "boxes", strict=True)
    with pytest.raises(InputError, match="truncated"):
        assemble(strict, [Draw(0, 0)], "view")


@pytest.mark.filterwarnings("ignore:.*left out")
def test_data_without_one_usable_picture_are_refused() -> None:
    objects = [replace(item, views=[broken(view) for view in item.views]) for item in make_objects(2, 2)]
    with pytest.raises(InputError, match="no picture can be used, the first: box1 view 1.png"):
        assemble(TrainingData(objects, "boxes"), [Draw(1, 1)], "view")


def test_an_object_whose_points_cannot_be_read_is_named_once_and_another_takes_its_place() -> None:
    def damaged() -> np.ndarray:
        raise InputError("target.ply: ends after 6 of 1024 rows, expected all")

    objects = make_objects(2)
    objects[0] = replace(objects[0], target=damaged)
    data = TrainingData(objects, "boxes")
    with pytest.warns(UserWarning, match="target.ply: ends after 6 of 1024 rows") as warned:
        replaced = assemble(data, [Draw(0, 1), Draw(0, 2)], "view")
    assert len(warned) == 1 and list(data.unusable) == ["box0"]
    np.testing.assert_array_equal(replaced.images, assemble(data, [Draw(1, 1), Draw(1, 2)], "view").images)
    # Its pictures are as good as any where no points are asked for.
    masks = assemble(data, [Draw(0, 1)], "view", targets=False)
    np.testing.assert_array_equal(masks.images[0], data.prepared(0, 1).image)
    with pytest.raises(InputError, match="ends after 6"):
        assemble(TrainingData(objects, "boxes", strict=True), [Draw(0, 0)], "view")


def test_of_a_flood_of_unusable_pictures_ten_are_warned_of_and_all_are_known() -> None:
    objects = make_objects(6, 4)
    objects[:5] = [replace(item, views=[broken(view) for view in item.views]) for item in objects[:5]]
    data = TrainingData(objects, "boxes")
    with pytest.warns(UserWarning, match="left out") as warned:
        assemble(data, [Draw(0, 0)], "view")
    assert len(warned) == 10 and len(data.unusable) == 20


def test_an_object_is_put_on_its_background_and_nothing_behind_it_shines_through() -> None:
    data = TrainingData(make_objects(1), "box", background="keep", backgrounds=Backgrounds("textures"))
    batch = assemble(data, [Draw(0, 0, background_seed=1), Draw(0, 0, background_seed=2), Draw(0, 0, mirror=True, background_seed=1)], "view")
    picture = data.prepared(0, 0)
    inside, outside = picture.mask == 1.0, picture.mask == 0.0
    for image in batch.images[:2]:
        np.testing.assert_allclose(image[:, inside], picture.image[:, inside], atol=1e-6)
        assert image[:, outside].std() > 0.01
    assert np.abs(batch.images[0] - batch.images[1])[:, outside].mean() > 0.05
    mirrored = batch.images[2][:, :, ::-1]
    np.testing.assert_allclose(mirrored[:, inside], picture.image[:, inside], atol=1e-6)
    with pytest.raises(InputError, match="background 'black', expected 'keep'"):
        TrainingData(make_objects(1), "box", backgrounds=Backgrounds("textures"))


def test_backgrounds_are_crops_of_the_photos_of_a_folder(tmp_path: Path) -> None:
    write_image(tmp_path / "red.png", np.full((40, 90, 3), (255, 0, 0), np.uint8))
    crop = Backgrounds(str(tmp_path)).sample(np.random.default_rng(0))
    np.testing.assert_allclose(crop, np.broadcast_to(np.float32([[[1]], [[0]], [[0]]]), (3, 64, 64)), atol=1e-6)
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="holds no picture"):
        Backgrounds(str(tmp_path / "empty"))
    with pytest.raises(InputError, match="not a folder, expected one with photos for backgrounds, or 'textures'"):
        Backgrounds(str(tmp_path / "none"))


def test_a_photo_that_cannot_be_read_is_named_once_and_the_next_one_stands_behind_the_object(tmp_path: Path) -> None:
    write_image(tmp_path / "red.png", np.full((40, 90, 3), (255, 0, 0), np.uint8))
    (tmp_path / "broken.png").write_bytes(b"no picture")
    behind = Backgrounds(str(tmp_path))
    with pytest.warns(UserWarning, match="broken.png: is not a readable image") as warned:
        crops = [behind.sample(np.random.default_rng(seed)) for seed in range(9)]
    assert min(crop[0].min() for crop in crops) > 0.99
    assert len(warned) == 1 and list(behind.unusable) == [str(tmp_path / "broken.png")]
    with pytest.raises(InputError, match="broken.png"):
        for seed in range(9):
            Backgrounds(str(tmp_path), strict=True).sample(np.random.default_rng(seed))
    (tmp_path / "red.png").unlink()
    with (
        pytest.warns(UserWarning, match="broken.png"),
        pytest.raises(InputError, match="no photo can be used, the first: .*broken.png"),
    ):
        Backgrounds(str(tmp_path)).sample(np.random.default_rng(0))


def test_a_category_with_its_own_kernel_is_compared_with_it_and_the_others_are_not() -> None:
    data = TrainingData([*make_objects(2), *make_objects(1, category="crate")], "boxes and a crate")
    batch = assemble(data, [Draw(0, 0, (1, 2)), Draw(1, 0, (1, 2)), Draw(2, 1, (0, 3))], "canonical")
    points = torch.from_numpy(np.stack(batch.targets))[:, ::4]
    alone = [mask_loss(points[i : i + 1], batch.select(np.array([i])), kernel, 0.5, "points")[0] for i, kernel in
             ((0, 0.4), (1, 0.4), (2, 1.5))]  # fmt: skip
    together, bce, outliers = mask_loss_by_category(points, batch, 0.4, {"crate": 1.5}, 0.5, "points")
    torch.testing.assert_close(together, torch.stack(alone).mean())
    assert float(together) == pytest.approx(bce + 0.5 * outliers, rel=1e-5)
    same, *_ = mask_loss_by_category(points, batch, 0.4, {}, 0.5, "points")
    torch.testing.assert_close(same, mask_loss(points, batch, 0.4, 0.5, "points")[0])
