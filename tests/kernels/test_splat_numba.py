"""The compiled loops: what they compute does not hang on threads, sizes or a writable disk."""

from __future__ import annotations

import subprocess
import sys
import threading

import pytest
import torch

from tso_cli.kernels import dispatch as choice
from tso_cli.kernels import jit
from tso_cli.kernels import nearest_numba as compiled_nearest
from tso_cli.kernels.splat import cheapest, splat


@pytest.fixture
def threads(monkeypatch):
    """Call with a number: that many threads, however little there is to do."""
    before = torch.get_num_threads()
    monkeypatch.setattr(jit, "WORTH_A_THREAD", 1)
    yield torch.set_num_threads
    torch.set_num_threads(before)


def _clouds(seed: int, images: int, count: int, size: float, dtype: torch.dtype = torch.float32):
    generator = torch.Generator().manual_seed(seed)
    points = (torch.rand(images, count, 2, generator=generator, dtype=dtype) * 1.4 - 0.2) * size
    return points, torch.rand(images, count, generator=generator) > 0.1


@pytest.mark.parametrize(("images", "count", "height", "width"), [(1, 5000, 200, 90), (7, 300, 40, 50), (3, 1, 5, 4)])
def test_sums_and_gradients_do_not_depend_on_the_number_of_threads_by_one_bit(threads, images, count, height, width):
    points, valid = _clouds(0, images, count, float(width))
    weight = torch.randn(images, height, width, generator=torch.Generator().manual_seed(1))
    found = []
    for number in (1, 2, 3, 8):
        threads(number)
        leaf = points.clone().requires_grad_()
        sums = splat(leaf, valid, height, width, 0.7, "compiled")
        (sums * weight).sum().backward()
        found.append((sums.detach(), leaf.grad))
    for sums, gradient in found[1:]:
        assert torch.equal(sums, found[0][0])
        assert torch.equal(gradient, found[0][1])


def test_neighbours_do_not_depend_on_the_number_of_threads(threads):
    points, valid = _clouds(2, 9, 50, 24.0)
    masks = torch.rand(9, 24, 24, generator=torch.Generator().manual_seed(3)) < 0.1
    clouds = [torch.rand(9, count, 3, generator=torch.Generator().manual_seed(count)) for count in (42, 44)]
    found = []
    for number in (1, 4):
        threads(number)
        index = compiled_nearest.nearest_points(masks, points, valid)
        found.append((index, *compiled_nearest.nearest_both_ways(*clouds)))
    assert all(torch.equal(one, four) for one, four in zip(*found, strict=True))


@pytest.mark.parametrize("sigma_sq", [1e-4, 0.05, 100.0])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_very_narrow_and_very_wide_kernels_are_those_of_the_exact_product(dtype, sigma_sq):
    points, valid = _clouds(5, 2, 40, 30.0, dtype)
    points[0, :4] = torch.tensor([[3.0, 3.0], [4.5, 6.0], [7.0, 7.5], [-0.5, 2.0]])
    leaves = [points.clone().requires_grad_() for _ in range(2)]
    exact, fast = (splat(p, valid, 30, 34, sigma_sq, k) for p, k in zip(leaves, ("exact", "compiled"), strict=True))
    (exact.tanh().sum() + fast.tanh().sum()).backward()
    torch.testing.assert_close(fast, exact, atol=1e-5 * exact.max().item(), rtol=0)
    largest = leaves[0].grad.abs().max().item()
    torch.testing.assert_close(leaves[1].grad, leaves[0].grad, atol=1e-5 * largest, rtol=0)


def test_no_points_and_no_images_give_empty_sums():
    assert splat(torch.empty(2, 0, 2), torch.empty(2, 0, dtype=torch.bool), 5, 6, 0.4, "compiled").abs().max() == 0.0
    assert splat(torch.empty(0, 3, 2), torch.empty(0, 3, dtype=torch.bool), 5, 6, 0.4, "compiled").shape == (0, 5, 6)


def test_points_that_are_no_numbers_add_nothing():
    points = torch.tensor([[[float("nan"), 3.0], [3.0, float("inf")], [2.0, 2.0]]])
    valid = torch.ones(1, 3, dtype=torch.bool)
    torch.testing.assert_close(splat(points, valid, 6, 6, 0.4, "compiled"), splat(points[:, 2:], valid[:, 2:], 6, 6, 0.4))
    index = compiled_nearest.nearest_points(torch.ones(1, 6, 6, dtype=torch.bool), points, valid)
    assert (index == 2).all()


def test_transposed_and_expanded_tensors_are_read_as_what_they_show():
    points, valid = _clouds(6, 1, 30, 20.0)
    sums = splat(points, valid, 20, 20, 0.4, "compiled")
    shuffled = points.transpose(1, 2).contiguous().transpose(1, 2)
    assert torch.equal(splat(shuffled.expand(3, -1, -1), valid.expand(3, -1), 20, 20, 0.4, "compiled")[2], sums[0])


def test_small_work_and_other_numbers_are_left_to_torch():
    assert cheapest(torch.zeros(8, 1024, 2), 64, 64, 0.4) == "compiled"
    assert cheapest(torch.zeros(1, 8191, 2), 64, 64, 0.4) == "windowed"
    assert cheapest(torch.zeros(1, 8191, 2), 20, 20, 6.4) == "exact"
    assert cheapest(torch.zeros(8, 1024, 2, dtype=torch.bfloat16), 64, 64, 0.4) == "windowed"
    assert cheapest(torch.zeros(8, 1024, 2, device="meta"), 64, 64, 0.4) == "windowed"


def test_refining_a_small_cloud_does_not_import_the_compiler():
    code = (
        "import sys, numpy as np; from tso_cli.refinement import RefineConfig, refine\n"
        "mask = np.zeros((64, 64), np.float32); mask[20:44, 20:44] = 1.0\n"
        "refine(np.random.default_rng(0).uniform(-0.3, 0.3, (1024, 3)), mask, config=RefineConfig(steps=1))\n"
        "assert 'numba' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_without_the_compiler_torch_does_the_work_and_says_so(monkeypatch):
    monkeypatch.setitem(sys.modules, "numba", None)
    choice._importable.cache_clear()
    try:
        with pytest.warns(UserWarning, match="numba cannot be imported"):
            assert cheapest(torch.zeros(8, 1024, 2), 64, 64, 0.4) == "windowed"
    finally:
        choice._importable.cache_clear()


def test_where_no_folder_can_be_written_the_loops_are_compiled_anew(monkeypatch):
    def njit(cache: bool = False, **settings: object):
        if cache:
            raise RuntimeError("cannot cache function: no locator available")
        return lambda function: function

    monkeypatch.setattr(jit, "njit", njit)

    def double(x: float) -> float:
        return 2.0 * x

    assert jit.compiled(double)(2.0) == 4.0


def test_a_disk_that_is_full_when_the_machine_code_is_kept_stops_nothing():
    calls = []

    def fill(first: int, last: int) -> None:
        calls.append((first, last))
        if len(calls) == 1:
            raise OSError(28, "No space left on device")

    jit.share(3, 1, fill)
    assert calls == [(0, 3), (0, 3)]


def test_what_goes_wrong_in_another_thread_is_not_lost(threads):
    threads(2)
    failed = threading.Event()

    def fail(first: int, last: int) -> None:
        if threading.current_thread() is threading.main_thread():
            assert failed.wait(60)
        else:
            failed.set()
            raise ValueError("no")

    with pytest.raises(ValueError, match="no"):
        jit.share(16, 1 << 40, fail)
