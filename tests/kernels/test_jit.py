"""Compiled code that is kept on disk."""

from __future__ import annotations

import os
import threading
import time

import pytest
import torch

from tso_cli.kernels.jit import forget_stale, share
from tso_cli.kernels.losses_numba import WithSlope
from tso_cli.kernels.projection_numba import project
from tso_cli.kernels.splat import splat


def test_what_was_compiled_before_any_source_changed_is_forgotten(tmp_path):
    kept = tmp_path / "__pycache__"
    kept.mkdir()
    for age, name in ((30, "one.py"), (10, "other.py"), (20, "__pycache__/one.f.nbi"), (5, "__pycache__/other.g.nbi")):
        (tmp_path / name).touch()
        os.utime(tmp_path / name, (1e9 - age, 1e9 - age))
    forget_stale(tmp_path)
    # a function of one.py may hold code of other.py, which is newer
    assert [path.name for path in kept.iterdir()] == ["other.g.nbi"]
    forget_stale(tmp_path / "absent")


def test_after_an_interrupt_no_thread_writes_any_more(monkeypatch):
    monkeypatch.setattr(torch, "get_num_threads", lambda: 2)
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
        share(100, 1 << 30, slow)
    done = list(running)
    # the range at work was ended, and no other begun
    assert len(done) == 2
    time.sleep(0.1)
    assert running == done


@pytest.mark.parametrize("kernel", ["windowed", "compiled"])
def test_second_derivatives_are_refused_and_not_silently_dropped(kernel):
    points = torch.rand(1, 5, 2, requires_grad=True)
    sums = splat(points, torch.ones(1, 5, dtype=torch.bool), 8, 8, 0.4, kernel)
    _assert_once(sums.square().sum(), points)


def test_second_derivatives_of_losses_and_projection_are_refused():
    points = torch.rand(1, 5, 3, requires_grad=True)
    value = WithSlope.apply(points, points.detach().sum((1, 2)), torch.ones_like(points))
    _assert_once(value.sum() * points.sum(), points)
    K, R, t = torch.eye(3).expand(1, 1, 3, 3), torch.eye(3).expand(1, 1, 3, 3), torch.ones(1, 1, 3)
    _assert_once(project(points, K, R, t, 0.01)[0].square().sum(), points)


def _assert_once(value, variable):
    (slope,) = torch.autograd.grad(value, variable, create_graph=True)
    with pytest.raises(RuntimeError, match="once_differentiable"):
        slope.sum().backward()
