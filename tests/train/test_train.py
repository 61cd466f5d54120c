"""Training: what it learns from, how it stops and goes on, and that it depends on nothing but seed and data."""

from __future__ import annotations

import json
import signal
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors.torch import load_file, save_file

from tests.dataset_trees import CHAIR, write_clouds, write_r2n2
from tso_cli.cli import main
from tso_cli.commands import options
from tso_cli.datasets.items import ViewItem
from tso_cli.datasets.opening import open_dataset
from tso_cli.datasets.rendered import write_object
from tso_cli.errors import InputError, TsoError
from tso_cli.geometry.camera import CANONICAL_ROTATION, Camera
from tso_cli.io.checkpoints import load_network
from tso_cli.network.model import NetworkConfig, build_network
from tso_cli.train import TrainConfig, evaluate, network_config, start, train
from tso_cli.train.batches import Batch, Draw, Drawing, assemble, draw_batch
from tso_cli.train.data import TrainingData
from tso_cli.train.losses import DROP, AffinitySchedule, mask_loss, point_loss
from tso_cli.train.sources import from_dataset
from tso_cli.train.state import TrainingState, load_training, save_training, state_path

from ..training import config, make_objects, make_thin

CPU = torch.device("cpu")


@pytest.fixture
def thin(monkeypatch: pytest.MonkeyPatch) -> None:
    make_thin(monkeypatch)


@pytest.fixture(scope="module")
def data() -> TrainingData:
    return TrainingData(make_objects(), "three boxes")


def batch(data: TrainingData, seed: int, step: int, size: int, views: int, frame: str) -> Batch:
    return draw_batch(data, Drawing(seed, size, frame, views), step)


def weights(network: torch.nn.Module) -> dict[str, torch.Tensor]:
    return {name: tensor.clone() for name, tensor in network.state_dict().items()}


def assert_equal(one: dict[str, torch.Tensor], other: dict[str, torch.Tensor]) -> None:
    assert one.keys() == other.keys()
    for name in one:
        assert torch.equal(one[name], other[name]), name


@pytest.mark.parametrize("frame", ["view", "canonical"])
def test_true_points_in_the_networks_frame_fill_the_supervising_masks(data: TrainingData, frame: str) -> None:
    """What `assemble` says of frames and cameras agrees with the pictures: every true point falls into every mask."""
    drawn = assemble(data, [Draw(0, 1, (0, 2, 3)), Draw(2, 0, (0, 1, 3))], frame)
    for b, target in enumerate(drawn.targets):
        for v in range(3):
            camera = Camera(drawn.K[b, v], drawn.R[b, v], drawn.t[b, v], 64, 64)
            pixels, depth = camera.project(target.astype(np.float64))
            assert depth.min() > 0
            column, row = np.rint(pixels).astype(int).T
            mask = np.pad(drawn.masks[b, v] > 0.2, 1)
            near = mask[1:-1, 1:-1] | mask[:-2, 1:-1] | mask[2:, 1:-1] | mask[1:-1, :-2] | mask[1:-1, 2:]
            assert near[row, column].all()


def test_a_view_aligned_target_has_the_axes_of_its_picture(data: TrainingData) -> None:
    """x right, y up, z toward the viewer: the canonical rotation leads back to the input camera's axes."""
    drawn = assemble(data, [Draw(1, 2)], "view")
    camera = data.objects[1].views[2].camera
    seen = data.target(1) @ camera.R.T
    np.testing.assert_allclose(drawn.targets[0] @ CANONICAL_ROTATION.T, seen, atol=1e-6)


def test_the_input_of_a_batch_is_that_of_the_shared_crop_rule(data: TrainingData) -> None:
    drawn = assemble(data, [Draw(1, 2)], "view")
    np.testing.assert_array_equal(drawn.images[0], data.prepared(1, 2).image)
    assert drawn.images.shape == (1, 3, 64, 64)


def test_every_object_comes_once_before_one_comes_again(data: TrainingData) -> None:
    for epoch in range(4):
        seen = [batch(data, 5, epoch * 3 + i, 1, 0, "canonical").targets[0] for i in range(3)]
        assert len({cloud.tobytes() for cloud in seen}) == 3


def test_a_batch_depends_on_seed_and_step_alone(data: TrainingData) -> None:
    one, same = (batch(data, 1, 4, 2, 2, "view") for _ in range(2))
    np.testing.assert_array_equal(one.images, same.images)
    np.testing.assert_array_equal(one.R, same.R)
    # one object: nothing but the step can change what is drawn
    single = TrainingData(data.objects[:1], "one box")
    assert len({batch(single, 1, step, 1, 1, "canonical").R.tobytes() for step in range(12)}) > 1
    assert any(not np.array_equal(one.R, batch(data, seed, step, 2, 2, "view").R) for seed, step in ((2, 4), (1, 5)))


@pytest.mark.parametrize("supervision", ["points", "masks"])
def test_the_loss_falls_in_a_few_steps(thin: None, data: TrainingData, supervision: str) -> None:
    result = train(data, config(supervision=supervision, steps=60, learning_rate=1e-3, saturation_steps=500))
    assert result.history[-10:, 0].mean() < 0.7 * result.history[:5, 0].mean()
    assert result.steps == 60 and result.stop_reason == "max_steps"


def test_masks_alone_bring_the_prediction_nearer_to_the_true_shape(thin: None, data: TrainingData) -> None:
    settings = config(
        supervision="masks", frame="canonical", steps=80, learning_rate=1e-3, points=256, batch_size=3, sigma_sq=2.0,
        saturation_steps=500,
    )  # fmt: skip
    before = sum(evaluate(start(data, settings).network, data, "canonical")[:2])
    assert sum(evaluate(train(data, settings).network, data, "canonical")[:2]) < 0.6 * before


def test_joint_training_lowers_both_the_distance_to_points_and_the_cross_entropy_of_masks(
    thin: None, data: TrainingData
) -> None:
    masked = TrainingData(make_objects(2), "two boxes with one mask each")
    settings = config(supervision="joint", steps=60, learning_rate=1e-3, batch_size=4, saturation_steps=500, sigma_sq=1.0)
    result = train(data, settings, masked=masked)
    first, last = result.history[:5].mean(0), result.history[-10:].mean(0)
    assert last[1] < 0.8 * first[1] and last[2] < 0.8 * first[2]
    assert result.config.settings["joint_weight"] == 1e6
    with pytest.raises(InputError, match="'joint' without images that have one mask each"):
        train(data, settings)
    with pytest.raises(InputError, match="'points' with images"):
        train(data, config(), masked=masked)
    with pytest.raises(InputError, match="batch size is 3, expected a multiple of 2"):
        train(data, config(supervision="joint", batch_size=3), masked=masked)


def test_mixed_precision_takes_nearly_the_same_steps(thin: None, data: TrainingData) -> None:
    exact, mixed = (train(data, config(steps=4, precision=name)) for name in ("float32", "bfloat16"))
    np.testing.assert_allclose(mixed.history[:, 0], exact.history[:, 0], rtol=0.02)
    assert not np.array_equal(mixed.history, exact.history)
    assert all(parameter.dtype == torch.float32 for parameter in mixed.network.parameters())


def test_the_averaged_network_is_saved_and_a_resume_goes_on_with_it(thin: None, data: TrainingData, tmp_path: Path) -> None:
    settings = {"averaging": 0.9, "augment": True, "balance": True}
    straight = train(data, config(**settings), save=saving(tmp_path / "straight.safetensors"))
    path = tmp_path / "base.safetensors"
    train(data, config(steps=3, **settings), save=saving(path))
    resumed = train(data, config(**settings), resume(path, data, config(**settings)), save=saving(path))
    assert_equal(weights(straight.network), weights(resumed.network))
    assert_equal(load_file(state_path(tmp_path / "straight.safetensors")), load_file(state_path(path)))
    last = train(data, config(augment=True, balance=True))
    assert not torch.equal(last.network.encoder.latent.weight, straight.network.encoder.latent.weight)
    with pytest.raises(InputError, match="trained with averaging 0.9, this run asks for 0.5"):
        resume(path, data, config(**{**settings, "averaging": 0.5}))


def test_training_goes_on_from_the_weights_it_is_given(thin: None, data: TrainingData) -> None:
    first = train(data, config()).network
    state = start(data, config(seed=5), first)
    assert_equal(weights(state.network), weights(first))
    with pytest.raises(InputError, match="predicts 64 points, expected 32"):
        start(data, config(points=32), first)


def test_the_chamfer_loss_is_zero_for_the_targets_themselves(data: TrainingData) -> None:
    drawn = draw_batch(data, Drawing(0, 2, "view", 0), 0)
    loss, forward, backward = point_loss(torch.from_numpy(np.stack(drawn.targets)), drawn)
    assert float(loss) == forward == backward == 0.0


def test_true_points_have_a_far_lower_mask_loss_than_moved_ones(data: TrainingData) -> None:
    drawn = draw_batch(data, Drawing(0, 2, "view", 3), 0)
    points = torch.from_numpy(np.stack(drawn.targets))
    true, bce, outliers = mask_loss(points, drawn, 0.4, 0.01, "points")
    moved, *_ = mask_loss(points + torch.tensor([0.2, 0.0, 0.0]), drawn, 0.4, 0.01, "points")
    assert float(true) < 0.2 * float(moved)
    assert float(true) == pytest.approx(bce + 0.01 * outliers, rel=1e-4)


def test_a_point_beyond_the_edge_of_the_crop_is_pulled_back(data: TrainingData) -> None:
    drawn = draw_batch(data, Drawing(0, 1, "view", 1), 0)
    points = torch.from_numpy(np.stack(drawn.targets))
    points[0, 0] = torch.tensor([0.9, 0.0, 0.0])
    points.requires_grad_(True)
    for weight in (0.0, 1.0):
        (gradient,) = torch.autograd.grad(mask_loss(points, drawn, 0.4, weight, "points")[0], points)
        camera = Camera(drawn.K[0, 0], drawn.R[0, 0], drawn.t[0, 0], 64, 64)
        ahead, _ = camera.project(
            np.stack([points[0, 0].detach(), points[0, 0].detach() - 0.01 * torch.sign(gradient[0, 0])]).astype(float)
        )
        outside = np.abs(ahead - 31.5).max(1)
        assert outside[0] > 32.0
        assert (outside[1] < outside[0] - 0.1) == (weight > 0.0)


def test_lambda_drops_to_a_fiftieth_once_the_running_mean_stops_falling() -> None:
    schedule = AffinitySchedule(2.0, window=3)
    for step, loss in enumerate([9.0, 9.0, 9.0, 6.0, 6.0, 6.0, 5.0, 5.0, 5.0], 1):
        schedule.observe(loss, step)
        assert schedule.weight == 2.0
    for step, loss in enumerate([5.0, 5.0, 4.99], 10):
        schedule.observe(loss, step)
    assert schedule.dropped_at == 12
    assert schedule.weight == DROP * 2.0
    schedule.observe(0.0, 13)
    assert schedule.weight == DROP * 2.0


def test_the_same_seed_gives_the_same_network_and_another_seed_another(thin: None, data: TrainingData) -> None:
    one, same, other = (weights(train(data, config(steps=3, seed=seed)).network) for seed in (1, 1, 2))
    assert_equal(one, same)
    assert not torch.equal(one["encoder.latent.weight"], other["encoder.latent.weight"])


def resume(path: Path, data: TrainingData, settings: TrainConfig) -> TrainingState:
    return load_training(path, network_config(data, settings, 0), data.fingerprint(), CPU)


def saving(path: Path) -> Any:
    return lambda state, saved: save_training(path, state, saved)


@pytest.mark.parametrize("supervision", ["points", "masks"])
def test_three_steps_and_three_more_after_a_resume_are_six_steps_bit_for_bit(
    thin: None, data: TrainingData, tmp_path: Path, supervision: str
) -> None:
    settings = {"supervision": supervision, "learning_rate": 1e-3}
    straight = train(data, config(**settings), save=saving(tmp_path / "straight.safetensors"))
    path = tmp_path / "base.safetensors"
    train(data, config(steps=3, **settings), save=saving(path))
    resumed = train(data, config(**settings), resume(path, data, config(**settings)), save=saving(path))
    assert_equal(weights(straight.network), weights(resumed.network))
    np.testing.assert_array_equal(straight.history, resumed.history)
    assert_equal(load_file(state_path(tmp_path / "straight.safetensors")), load_file(state_path(path)))


def test_lambda_may_drop_from_a_third_of_the_steps_on_however_few_there_are() -> None:
    assert [TrainConfig(steps=steps).saturation_steps for steps in (6, 600, 20_000)] == [10, 100, 500]
    assert TrainConfig(steps=600, saturation_steps=7).saturation_steps == 7


def test_a_resumed_schedule_knows_what_it_had_seen(thin: None, data: TrainingData, tmp_path: Path) -> None:
    settings = config(supervision="masks", steps=3)
    state = start(data, settings)
    train(data, settings, state, save=saving(tmp_path / "base.safetensors"))
    assert state.schedule.previous is not None and state.schedule.count == 1
    assert resume(tmp_path / "base.safetensors", data, settings).schedule == state.schedule


def test_a_resume_of_the_full_network_is_bit_for_bit_too(data: TrainingData, tmp_path: Path) -> None:
    path = tmp_path / "base.safetensors"
    straight = train(data, config(steps=2))
    train(data, config(steps=1), save=saving(path))
    assert_equal(weights(straight.network), weights(train(data, config(steps=2), resume(path, data, config())).network))


def test_a_checkpoint_in_mid_training_is_one_that_refinement_can_read(thin: None, data: TrainingData, tmp_path: Path) -> None:
    path = tmp_path / "base.safetensors"
    steps = []

    def save(state: TrainingState, saved: NetworkConfig) -> None:
        save_training(path, state, saved)
        network, read = load_network(path)
        assert_equal(weights(network), weights(state.network))
        steps.append(read.steps)
        assert (read.frame, read.supervision, read.points, read.training_set) == ("view", "points", 64, "three boxes")

    train(data, config(steps=5), save=save, save_every=2)
    assert steps == [2, 4, 5]


def test_ctrl_c_finishes_the_step_and_writes_a_state_to_go_on_from(thin: None, data: TrainingData, tmp_path: Path) -> None:
    path = tmp_path / "base.safetensors"
    before = signal.getsignal(signal.SIGINT)

    def press(done: int, total: int, note: str) -> None:
        if done == 2:
            signal.raise_signal(signal.SIGINT)

    result = train(data, config(), progress=press, save=saving(path))
    assert (result.stop_reason, result.steps) == ("interrupted", 2)
    assert signal.getsignal(signal.SIGINT) is before
    resumed = train(data, config(), resume(path, data, config()))
    assert_equal(weights(train(data, config()).network), weights(resumed.network))


def test_a_second_ctrl_c_goes_through_at_once(thin: None, data: TrainingData) -> None:
    def press(*_: Any) -> None:
        signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        train(data, config(), progress=press)


def test_a_loss_that_is_no_number_stops_the_training_in_one_line(
    thin: None, data: TrainingData, monkeypatch: pytest.MonkeyPatch
) -> None:
    state = start(data, config())
    with torch.no_grad():
        list(state.network.parameters())[-1].fill_(float("nan"))
    monkeypatch.setattr("tso_cli.train.step.point_loss", lambda points, batch: (points.sum(), 0.0, 0.0))
    with pytest.raises(TsoError, match=r"became nan in step 1 .*nothing was written"):
        train(data, config(), state)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"learning_rate": 1e-4}, "trained with learning_rate 5e-05, this run asks for 0.0001"),
        ({"points": 32}, "trained with points 64, this run asks for 32"),
        ({"frame": "canonical"}, "trained with frame 'view'"),
        ({"supervision": "masks"}, "trained with"),
        ({"seed": 3}, "trained with seed 0"),
    ],
)
def test_a_resume_with_other_settings_is_refused(
    thin: None, data: TrainingData, tmp_path: Path, change: dict[str, Any], message: str
) -> None:
    train(data, config(steps=1), save=saving(tmp_path / "base.safetensors"))
    with pytest.raises(InputError, match=message):
        resume(tmp_path / "base.safetensors", data, config(**change))


def test_a_resume_on_other_data_or_without_state_or_of_what_is_done_is_refused(
    thin: None, data: TrainingData, tmp_path: Path
) -> None:
    path = tmp_path / "base.safetensors"
    with pytest.raises(InputError, match=r"base.training.safetensors: does not exist"):
        resume(path, data, config())
    train(data, config(steps=2), save=saving(path))
    with pytest.raises(InputError, match="2 steps are done already"):
        train(data, config(steps=2), resume(path, data, config()))
    with pytest.raises(InputError, match="other data"):
        resume(path, TrainingData(make_objects(2), "three boxes"), config())
    path.replace(state_path(path))
    with pytest.raises(InputError, match="step in the training state is None"):
        resume(path, data, config())


def test_a_damaged_training_state_is_refused(thin: None, data: TrainingData, tmp_path: Path) -> None:
    path = tmp_path / "base.safetensors"
    train(data, config(steps=1), save=saving(path))
    file = state_path(path)
    tensors, metadata = load_file(file), _metadata(file)
    whole = json.loads(metadata["tso"])
    good = whole["training"]
    broken = {**good["schedule"], "window": "x"}
    for change in ({"schedule": 3}, {"schedule": broken}, {"step": -1}, {"step": 7}):
        save_file(tensors, file, {"tso": json.dumps({**whole, "training": {**good, **change}})})
        with pytest.raises(InputError, match=file.name):
            resume(path, data, config())
    tensors.pop("training.exp_avg.encoder.latent.weight")
    save_file(tensors, file, metadata)
    with pytest.raises(InputError, match="exp_avg.encoder.latent.weight is missing"):
        resume(path, data, config())


def _metadata(path: Path) -> dict[str, str]:
    raw = path.read_bytes()
    header = json.loads(raw[8 : 8 + int.from_bytes(raw[:8], "little")])
    values: dict[str, str] = header["__metadata__"]
    return values


@pytest.mark.parametrize(
    "change",
    [{"steps": 0}, {"views": 0}, {"batch_size": -1}, {"seed": -1}, {"learning_rate": 0.0}, {"learning_rate": float("nan")},
     {"sigma_sq": -0.4}, {"affinity_weight": -1.0}, {"supervision": "depth"}, {"frame": "world"}, {"affinity": "none"},
     {"precision": "float16"}, {"averaging": 1.0}, {"workers": 0}, {"category_sigma_sq": {"car": 0.0}}, {"joint_weight": 0.0}],
)  # fmt: skip
def test_impossible_settings_are_refused(change: dict[str, Any]) -> None:
    with pytest.raises(InputError, match="expected"):
        config(**change)


def test_more_supervising_views_than_there_are_is_refused(thin: None, data: TrainingData) -> None:
    with pytest.raises(InputError, match="box0: has 4 views, expected at least the 5"):
        train(data, config(supervision="masks", views=5))


def test_an_empty_training_set_is_refused() -> None:
    with pytest.raises(InputError, match="no object"):
        TrainingData([], "nothing")


def test_evaluation_of_a_perfect_prediction_is_zero(data: TrainingData) -> None:
    class Oracle(torch.nn.Linear):
        def forward(self, images: torch.Tensor) -> torch.Tensor:
            return torch.from_numpy(data.target(0)).expand(len(images), -1, -1)

    one = TrainingData(data.objects[:1], "one box")
    forward, backward, _ = evaluate(Oracle(1, 1), one, "canonical")  # type: ignore[arg-type]
    assert forward == pytest.approx(0.0, abs=1e-12) and backward == pytest.approx(0.0, abs=1e-12)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """The boxes as `tso render` would have written them."""
    for item in make_objects(2):
        views = []
        for view in item.views:
            image, mask = view.load()
            views.append((image, (mask * 255).astype(np.uint8), view.camera))
        points = item.target() if item.target else np.empty((0, 3), np.float32)
        write_object(tmp_path / "boxes" / item.name, views, points, points, {"seed": 0})
    return tmp_path / "boxes"


def run(*arguments: object) -> int:
    with pytest.raises(SystemExit) as stopped:
        main(["train", *(str(argument) for argument in arguments)])
    code = stopped.value.code
    assert isinstance(code, int)
    return code


def test_a_rendered_folder_gives_the_batches_that_its_pictures_gave_in_memory(folder: Path) -> None:
    read, made = from_dataset(open_dataset(folder)), TrainingData(make_objects(2), "boxes")
    one, other = (batch(item, 0, 0, 2, 2, "view") for item in (read, made))
    np.testing.assert_allclose(one.images, other.images, atol=1e-6)
    np.testing.assert_allclose(one.masks, other.masks, atol=1e-6)
    np.testing.assert_allclose(one.K, other.K)
    np.testing.assert_allclose(one.targets, other.targets, atol=1e-6)


def test_masks_teach_objects_without_a_3d_file_and_the_judgement_counts_them(
    thin: None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_r2n2(tmp_path / "ShapeNetRendering", ("abc", "def"))
    write_clouds(tmp_path, "abc")
    settings = ["-o", tmp_path / "base.safetensors", "--steps", 2, "--batch-size", 2, "--points", 32, "--json", "--overwrite"]
    assert run(tmp_path, *settings, "--supervision", "masks", "--views", 2) == 0
    document = json.loads(capsys.readouterr().out)
    assert (document["objects"], document["chamfer_training"]["shapes"], document["left_out"]) == (2, 1, {})
    assert document["not_judged"][f"{CHAIR}/def"].endswith("does not exist, expected the shape of this object")
    assert run(tmp_path, *settings) == 0
    captured = capsys.readouterr()
    document = json.loads(captured.out)
    assert (document["objects"], document["not_judged"], list(document["left_out"])) == (1, {}, [f"{CHAIR}/def"])
    assert "pcl_1024_fps_trimesh.npy: does not exist" in captured.err
    assert run(tmp_path, *settings, "--strict") == 2
    assert "pcl_1024_fps_trimesh.npy: does not exist" in capsys.readouterr().err


def test_a_damaged_3d_file_stops_no_training_by_masks_and_no_other_object_is_judged_in_its_place(
    thin: None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_r2n2(tmp_path / "ShapeNetRendering", ("abc", "def", "ghi"))
    write_clouds(tmp_path, "abc", "def", "ghi")
    damaged = tmp_path / "ShapeNet_pcl" / CHAIR / "def" / "pcl_1024_fps_trimesh.npy"
    damaged.write_bytes(b"no array")
    settings = [tmp_path, "-o", tmp_path / "base.safetensors", "--steps", 2, "--batch-size", 2, "--points", 32, "--json"]
    assert run(*settings, "--supervision", "masks", "--views", 2, "--strict") == 0
    captured = capsys.readouterr()
    document = json.loads(captured.out)
    assert (document["chamfer_training"]["shapes"], document["left_out"]) == (2, {})
    assert str(damaged) in document["not_judged"][f"{CHAIR}/def"]
    assert "left out" not in captured.err


def test_a_resumed_run_keeps_its_window_of_saturation(thin: None, folder: Path, tmp_path: Path) -> None:
    settings = [folder, "-o", tmp_path / "base.safetensors", "--batch-size", 2, "--points", 32, "--supervision", "masks"]
    settings += ["--views", 2, "--checkpoint-every", 0]
    assert run(*settings, "--steps", 2, "--saturation-steps", 3) == 0
    assert run(*settings, "--steps", 4, "--resume") == 0
    assert load_network(tmp_path / "base.safetensors")[1].settings["saturation_steps"] == 3
    assert run(*settings, "--steps", 6, "--resume", "--saturation-steps", 3) == 0
    assert run(*settings, "--steps", 8, "--resume", "--saturation-steps", 4) == 2


@pytest.mark.parametrize("share", ["-1", "nan", "1.5"])
def test_a_share_that_is_none_is_refused_before_anything_is_opened(
    share: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(tmp_path / "nowhere", "--crop-share", share) == 2
    assert f"--crop-share is {float(share):g}, expected 0 to 1" in capsys.readouterr().err


def test_every_figure_says_the_scale_it_is_in(
    thin: None, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The same clouds in several scales."""
    root = tmp_path / "r2n2"
    write_r2n2(root / "ShapeNetRendering")
    write_clouds(root, "abc")
    settings = [root, "-o", tmp_path / "base.safetensors", "--steps", 2, "--batch-size", 2, "--points", 32, "--overwrite"]
    assert run(folder, *settings[1:], "--crop-share", 0) == 0
    assert "mean over points, unit diagonal; N 32" in capsys.readouterr().out
    for share, scale in ((0.9, "longest side 1"), (0, "units of the data set")):
        assert run(*settings, "--crop-share", share) == 0
        assert f"mean over points, {scale}; N 32" in capsys.readouterr().out
        assert load_network(tmp_path / "base.safetensors")[1].crop_share == share


def test_the_command_trains_on_a_folder_and_says_what_it_did(
    thin: None, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output, log = tmp_path / "base.safetensors", tmp_path / "log.jsonl"
    code = run(folder, "-o", output, "--steps", 4, "--batch-size", 2, "--points", 32, "--log-file", log, "--json",
               "--supervision", "masks", "--views", 2)  # fmt: skip
    assert code == 0
    captured = capsys.readouterr()
    document = json.loads(captured.out)
    assert (document["steps"], document["stop_reason"], document["supervision"]) == (4, "max_steps", "masks")
    assert document["chamfer_training"]["chamfer"] > 0
    assert load_network(output)[1].settings["lambda"] == 1.0
    lines = log.read_text().splitlines()
    assert json.loads(lines[0])["settings"]["views"] == 2 and len(lines) == 5
    assert list(json.loads(lines[4])) == ["step", "loss", "bce", "affinity", "lambda"]
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "base.safetensors", "base.training.safetensors", "boxes", "log.jsonl",
    ]  # fmt: skip


def test_joint_training_at_the_command_line_takes_each_data_set_by_its_own_split(
    thin: None, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    split, other = tmp_path / "split.json", tmp_path / "other.json"
    split.write_text(json.dumps({"train": ["box0"], "validation": [], "test": ["box1"]}))
    other.write_text(json.dumps({"train": ["box1"], "validation": [], "test": ["box0"]}))
    code = run(folder, "-o", tmp_path / "a.safetensors", "--steps", 2, "--batch-size", 2, "--points", 32, "--split", split,
               "--supervision", "joint", "--mask-data", folder, "--mask-split", other, "--json")  # fmt: skip
    assert code == 0
    document = json.loads(capsys.readouterr().out)
    assert document["training_set"] == "boxes: 1 objects" and document["supervision"] == "joint"
    assert load_network(tmp_path / "a.safetensors")[1].settings["views"] == 1


def test_of_the_categories_that_are_not_wanted_a_split_may_name_what_is_not_there(
    thin: None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for item in (*make_objects(2, category="box"), *make_objects(1, category="crate")):
        image, mask = item.views[0].load()
        views = [(image, (mask * 255).astype(np.uint8), item.views[0].camera)]
        assert item.target is not None
        write_object(tmp_path / "data" / item.category / item.name, views, item.target(), item.target(), {"seed": 0})
    (tmp_path / "data/box/box1/target.ply").unlink()
    split = tmp_path / "split.json"
    split.write_text(json.dumps({"train": ["box/box0", "crate/absent"], "test": ["box/box1"]}))
    common = [tmp_path / "data", "--split", split, "--steps", 1, "--batch-size", 1, "--points", 32]
    assert run(*common, "--category", "box", "-o", tmp_path / "a.safetensors", "--json") == 0
    document = json.loads(capsys.readouterr().out)
    assert document["training_set"] == "data: 1 objects"
    assert list(document["left_out"]) == ["box/box1"]
    for category, message in (("crate", "split.json: names crate/absent, expected"), ("tin", "has no category 'tin'")):
        assert run(*common, "--category", category, "-o", tmp_path / "b.safetensors") == 2
        assert message in capsys.readouterr().err
    split.write_text(json.dumps({"test": ["box/box0"]}))
    assert run(*common, "-o", tmp_path / "b.safetensors") == 2
    assert "split.json: has no list 'train', expected one beside 'test'" in capsys.readouterr().err


def test_data_without_points_are_trained_on_by_their_masks_and_not_judged(
    thin: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    bare = TrainingData([replace(item, target=None) for item in make_objects(2)], "boxes without points")
    monkeypatch.setattr("tso_cli.commands.train.load", lambda wanted, quiet: bare)
    common = [tmp_path, "--steps", 2, "--batch-size", 2, "--points", 32]
    assert run(*common, "-o", tmp_path / "a.safetensors", "--supervision", "masks", "--views", 2) == 0
    assert "2 steps" in capsys.readouterr().out
    assert run(*common, "-o", tmp_path / "b.safetensors") == 2
    assert "box0: has no points to learn from" in capsys.readouterr().err
    assert not (tmp_path / "b.safetensors").exists()


def test_ctrl_c_at_the_command_line_is_130_and_resume_goes_on(
    thin: None, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    common = ["--steps", 4, "--batch-size", 2, "--points", 32]
    assert run(folder, "-o", tmp_path / "straight.safetensors", *common) == 0
    shown = options.ProgressBar.__call__

    def press(bar: options.ProgressBar, done: int, total: int, note: str = "") -> None:
        shown(bar, done, total, note)
        if bar.label == "train" and done == 2:
            signal.raise_signal(signal.SIGINT)

    output = tmp_path / "base.safetensors"
    with monkeypatch.context() as patch:
        patch.setattr(options.ProgressBar, "__call__", press)
        assert run(folder, "-o", output, *common) == 130
    assert "interrupted after 2 of 4 steps" in capsys.readouterr().err
    assert load_network(output)[1].steps == 2
    assert run(folder, "-o", output, *common, "--resume") == 0
    assert "resuming after 2 steps" in capsys.readouterr().err
    assert output.read_bytes() == (tmp_path / "straight.safetensors").read_bytes()


def test_the_command_refuses_in_one_line_and_writes_nothing(
    thin: None, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "there.safetensors").write_bytes(b"mine")
    cases: list[tuple[list[object], str]] = [
        ([tmp_path / "none"], "none"),
        ([folder, "-o", tmp_path / "there.safetensors"], "exists"),
        ([folder, "-o", tmp_path / "missing" / "a.safetensors"], "missing"),
        ([folder, "-o", tmp_path / "a.pth"], "expected a checkpoint name in .safetensors"),
        ([folder, "-o", tmp_path / "a.safetensors", "--resume"], "a.training.safetensors: does not exist"),
        ([folder, "-o", tmp_path / "a.safetensors", "--steps", 0], "steps is 0"),
        ([folder, "-o", tmp_path / "a.safetensors", "--crop-share", 2], "--crop-share is 2"),
        ([folder, "-o", tmp_path / "a.safetensors", "--device", "cuda:99"], "cuda:99"),
        ([folder, "-o", tmp_path / "a.safetensors", "--frame", "world"], "world"),
        ([folder, "-o", tmp_path / "a.safetensors", "--mask-data", folder], "expected joint with --mask-data"),
        ([folder, "-o", tmp_path / "a.safetensors", "--supervision", "joint"], "joint, expected --mask-data FOLDER with it"),
        ([folder, "-o", tmp_path / "a.safetensors", "--views", 2], "--views is for --supervision masks, found points"),
        ([folder, "-o", tmp_path / "a.safetensors", "--mask-split", folder], "--mask-split is for --supervision joint"),
        ([folder, "-o", tmp_path / "a.safetensors", "--lambda", 2], "--lambda is for --supervision masks or joint"),
        ([folder, "--supervision", "masks", "--category-sigma-sq", "crate=1"], "sigma^2 is given for 'crate', expected one of"),
        ([folder, "-o", tmp_path / "a.safetensors", "--log-file", tmp_path / "a.safetensors"], "expected a file of its own"),
    ]
    before = sorted(tmp_path.iterdir())
    for arguments, expected in cases:
        if "-o" not in arguments:
            arguments = [*arguments, "-o", tmp_path / "a.safetensors"]
        assert run(*arguments) == 2, arguments
        lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith("tso: error:")]
        assert len(lines) == 1 and expected in lines[0], (arguments, lines)
    assert sorted(tmp_path.iterdir()) == before
    assert (tmp_path / "there.safetensors").read_bytes() == b"mine"


def test_the_shipped_meshes_and_examples_make_a_training_set() -> None:
    pytest.importorskip("open3d")
    from tso_cli.io.shipped import example_meshes
    from tso_cli.train.sources import from_meshes, shipped_examples

    meshes = example_meshes()
    assert {path.parent.name for path in meshes} == {"airplane", "car", "chair"}
    rendered = from_meshes(meshes[:2], "two", views=2)
    same = from_meshes(meshes[:2], "two", views=2)
    assert rendered.fingerprint() == same.fingerprint()
    np.testing.assert_array_equal(batch(rendered, 0, 0, 2, 1, "view").images, batch(same, 0, 0, 2, 1, "view").images)
    unseen = shipped_examples()
    assert [item.name for item in unseen.objects] == ["chair", "car", "airplane"]
    forward, backward, shapes = evaluate(build_network(64), unseen, "view")
    assert shapes == 3
    assert forward > 0 and backward > 0


def test_other_pictures_of_the_same_objects_are_other_data() -> None:
    def dark(view: ViewItem) -> ViewItem:
        image, mask = view.load()
        return replace(view, load=lambda: (image // 2, mask))

    objects = make_objects(2)
    changed = [objects[0], replace(objects[1], views=[dark(objects[1].views[0]), *objects[1].views[1:]])]
    same, other = TrainingData(make_objects(2), "two"), TrainingData(changed, "two")
    assert TrainingData(objects, "two").fingerprint() == same.fingerprint() != other.fingerprint()


def test_of_many_objects_a_few_that_lie_evenly_are_judged(data: TrainingData) -> None:
    read = []

    def target(number: int) -> Any:
        return lambda: (read.append(number), data.target(number % 3))[1]

    objects = [replace(data.objects[i % 3], name=f"box{i}", target=target(i)) for i in range(100)]
    assert evaluate(build_network(64), TrainingData(objects, "boxes"), "canonical", views=1, most=5)[2] == 5
    assert read == [0, 25, 50, 74, 99]


def test_an_orthographic_camera_is_refused_and_not_taken_for_a_perspective_one() -> None:
    item = make_objects(count=1, views=1)[0]
    camera = replace(item.views[0].camera, model="orthographic")
    with pytest.raises(InputError, match="orthographic, expected perspective"):
        TrainingData([replace(item, views=[replace(item.views[0], camera=camera)])], "one")


def test_a_full_disk_leaves_the_checkpoint_that_was_there(
    thin: None, data: TrainingData, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "base.safetensors"
    train(data, config(steps=2), save=saving(path))
    before = {file.name: file.read_bytes() for file in tmp_path.iterdir()}

    def full(self: Path, content: bytes) -> int:
        with self.open("wb") as stream:
            stream.write(content[: len(content) // 2])
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch, pytest.raises(TsoError, match="No space left on device"):
        patch.setattr(Path, "write_bytes", full)
        train(data, config(steps=4), resume(path, data, config()), save=saving(path))
    assert {file.name: file.read_bytes() for file in tmp_path.iterdir()} == before
    assert resume(path, data, config()).step == 2


def test_a_state_of_another_architecture_is_refused(thin: None, data: TrainingData, tmp_path: Path) -> None:
    path = tmp_path / "base.safetensors"
    train(data, config(steps=1), save=saving(path))
    file = state_path(path)
    tensors, metadata = load_file(file), _metadata(file)
    tensors["encoder.convolutions.0.weight"] = torch.zeros(8, 3, 3, 3)
    save_file(tensors, file, metadata)
    with pytest.raises(InputError, match=r"encoder.convolutions.0.weight has shape \[8, 3, 3, 3\], expected \[4, 3, 3, 3\]"):
        resume(path, data, config())
