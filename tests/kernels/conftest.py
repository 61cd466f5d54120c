"""Running a function in both forms, and on several threads."""

from collections.abc import Callable
from typing import Any

import pytest
import torch

from tso_cli.kernels import jit, tensors


@pytest.fixture
def both_forms(monkeypatch) -> Callable[[Callable[[], Any]], tuple[Any, Any]]:
    """What a function returns in plain torch, and in compiled loops."""

    def run(function: Callable[[], Any]) -> tuple[Any, Any]:
        results = []
        for least in (1 << 60, 0):
            monkeypatch.setattr(tensors, "POINTS_WORTH_COMPILING", least)
            results.append(function())
        return results[0], results[1]

    return run


@pytest.fixture
def assert_same_on_threads(monkeypatch) -> Any:
    """Assert that the tensors a function returns have the same bits on 1, 2 and 7 threads.

    Threads share the work however small it is.
    """
    monkeypatch.setattr(jit, "STEPS_WORTH_A_THREAD", 1)
    threads = torch.get_num_threads()

    def check(function: Callable[[], tuple[torch.Tensor, ...]]) -> None:
        results = []
        for number in (1, 2, 7):
            torch.set_num_threads(number)
            results.append(function())
        for result in results[1:]:
            assert all(torch.equal(a, b) for a, b in zip(result, results[0], strict=True))

    yield check
    torch.set_num_threads(threads)
