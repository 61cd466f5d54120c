"""Compiled code on disk, its threads, its exponentials, and its gradients."""

import os
import signal
import threading
import time

import numpy as np
import pytest
import torch
from numba import njit

from tests.corruption import full_disk
from tso_cli.kernels import jit, simd
from tso_cli.kernels.jit import share, tidy
from tso_cli.kernels.splat import splat
from tso_cli.kernels.tensors import PrecomputedGradient


def test_machine_code_older_than_any_source_is_removed(tmp_path, monkeypatch):
    # A function of one file may contain code of another one, which is newer.
    monkeypatch.setattr(jit, "_sources_changed", lambda: 1e9)
    for age, name in ((20, "one.f.nbi"), (-5, "two.g.nbi")):
        (tmp_path / name).touch()
        os.utime(tmp_path / name, (1e9 - age, 1e9 - age))
    tidy(str(tmp_path))
    assert [path.name for path in tmp_path.iterdir()] == ["two.g.nbi"]
    tidy(str(tmp_path / "absent"))


def test_what_a_killed_process_left_with_the_machine_code_is_removed_a_minute_later(
    tmp_path, monkeypatch
):
    monkeypatch.setattr(jit, "_sources_changed", lambda: 0.0)
    stale, living, *others = paths = [
        tmp_path / name
        for name in ("a.1.nbc.tmp.0", "a.nbi.tmp.1", "a.1.nbc", "a.nbi", "notes.tmp.0")
    ]
    for path in paths:
        path.touch()
        if path != living:
            os.utime(path, (1e9, 1e9))
    tidy(str(tmp_path))
    assert not stale.exists()
    assert all(path.exists() for path in (living, *others))


def test_without_a_writable_folder_the_loops_are_compiled_in_every_process(monkeypatch):
    def no_folder(function):
        raise RuntimeError("cannot cache function: no locator available")

    monkeypatch.setattr(jit, "_Cache", no_folder)
    assert jit.kept_on_disk(lambda x: 2.0 * x)(2.0) == 4.0


def test_machine_code_for_other_types_is_not_run(tmp_path):
    """As where two processes gave the code of two types one name."""
    file = jit._CheckedFile(str(tmp_path), "loop", "stamp")
    file.save("float32", "code")
    file.save("float64", "other code")
    assert (file.load("float32"), file.load("float64")) == ("code", "other code")
    (tmp_path / "loop.2.nbc").replace(tmp_path / "loop.1.nbc")
    assert file.load("float32") is None


def test_of_a_writer_that_is_killed_the_index_names_no_older_code(tmp_path, monkeypatch):
    file = jit._CheckedFile(str(tmp_path), "loop", "stamp")
    monkeypatch.setattr(file, "_save_data", full_disk)
    with pytest.raises(OSError, match="No space"):
        file.save("float32", "code")
    assert file._load_index() == {}


def test_a_full_disk_does_not_stop_the_work(monkeypatch):
    monkeypatch.setattr(jit._CheckedFile, "save", full_disk)
    monkeypatch.setattr(jit, "_warned", [])
    with pytest.warns(UserWarning, match="No space left on device.*compiled anew"):
        assert jit.kept_on_disk(lambda x: 2.0 * x)(2.0) == 4.0


def test_ctrl_c_while_a_loop_is_compiled_arrives_when_it_is():
    loop = jit.kept_on_disk(lambda x: 2.0 * x)

    def interrupted(*_):
        signal.raise_signal(signal.SIGINT)

    loop._cache.load_overload = interrupted
    with pytest.raises(KeyboardInterrupt):
        loop(2.0)
    assert loop.signatures
    assert loop(2.0) == 4.0


def test_after_an_interrupt_no_thread_writes():
    caller, begun, running = threading.get_ident(), threading.Event(), []

    def slow(first, last):
        if threading.get_ident() == caller:
            begun.wait(5.0)
            raise KeyboardInterrupt
        running.append(first)
        begun.set()
        time.sleep(0.05)
        running.append(last)

    with pytest.raises(KeyboardInterrupt):
        share(100, 1 << 30, 2, slow)
    done = list(running)
    # the range at work was ended, and no further one begun
    assert len(done) == 2
    time.sleep(0.1)
    assert running == done


def test_an_error_in_another_thread_is_raised():
    failed = threading.Event()

    def fail(first: int, last: int) -> None:
        if threading.current_thread() is threading.main_thread():
            assert failed.wait(60)
        else:
            failed.set()
            raise ValueError("no")

    with pytest.raises(ValueError, match="no"):
        share(16, 1 << 40, 2, fail)


def _silhouette(kernel):
    return lambda points: (
        splat(points[..., :2], torch.ones(1, 5, dtype=torch.bool), 8, 8, 0.4, kernel).square().sum()
    )


def _loss(points):
    return (
        PrecomputedGradient.apply(
            points, points.detach().sum((1, 2)), torch.ones_like(points)
        ).sum()
        * points.sum()
    )


@pytest.mark.parametrize("function", [_silhouette("compiled"), _loss])
def test_second_derivatives_are_refused_and_not_silently_dropped(function):
    points = torch.rand(1, 5, 3, requires_grad=True)
    (gradient,) = torch.autograd.grad(function(points), points, create_graph=True)
    with pytest.raises(RuntimeError, match="once_differentiable"):
        gradient.sum().backward()


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_exponentials_and_logarithms_are_those_of_numpy(dtype):
    @njit
    def both(x, powers, logs):
        for i in range(len(x)):
            powers[i], logs[i] = simd.exp(-x[i]), simd.log(x[i])

    x = np.geomspace(1e-30, 80.0, 20001).astype(dtype)
    powers, logs = np.empty_like(x), np.empty_like(x)
    both(x, powers, logs)
    near = x < 1.0
    exact = np.exp(-x.astype(np.float64))
    precision = 3e-7 if dtype == np.float32 else 1e-15
    np.testing.assert_allclose(powers[near], exact[near], rtol=precision)
    np.testing.assert_allclose(powers, exact, rtol=20 * precision)
    np.testing.assert_allclose(logs, np.log(x.astype(np.float64)), rtol=precision, atol=precision)
