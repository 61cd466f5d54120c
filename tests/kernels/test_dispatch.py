"""Which form of a kernel runs, and what a refinement imports."""

import os
import subprocess
import sys
import warnings
from concurrent.futures import ThreadPoolExecutor
from contextvars import copy_context

import pytest
import torch

from tso_cli.kernels import dispatch
from tso_cli.kernels.dispatch import importable, planned, use_compiled
from tso_cli.kernels.tensors import use_numba


@pytest.fixture(autouse=True)
def new_process(monkeypatch):
    """This process has not refined anything yet."""
    monkeypatch.setattr(dispatch, "_earlier", [0.0])


def test_a_process_that_goes_on_takes_the_loops_that_are_on_disk(monkeypatch):
    """As in a notebook: each refinement alone is too small to load them."""
    monkeypatch.setattr(dispatch, "on_disk", lambda: True)
    used = []
    for _ in range(12):
        with planned(200, 0):
            used.append(use_compiled())
    assert not used[0]
    assert used[-1]
    assert used == sorted(used)


@pytest.mark.parametrize("on_disk", [True, False])
def test_small_work_is_left_to_numpy_and_large_work_compiled(monkeypatch, on_disk):
    monkeypatch.setattr(dispatch, "on_disk", lambda: on_disk)
    assert not use_compiled()
    with planned(1, 1):
        assert not use_compiled()
    with planned(1_000_000, 100_000_000):
        assert use_compiled()
        # The outermost plan decides, in threads too.
        with planned(1, 1), ThreadPoolExecutor(1) as pool:
            assert use_compiled()
            assert pool.submit(copy_context().run, use_compiled).result()
    assert not use_compiled()


def test_work_that_repays_loading_but_not_compiling_needs_machine_code_on_disk(monkeypatch):
    for on_disk in (True, False):
        monkeypatch.setattr(dispatch, "on_disk", lambda on_disk=on_disk: on_disk)
        with planned(50, 50 * 65536), warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            assert use_compiled() == use_compiled() == on_disk
        # Said once, and the choice stays.
        assert ["`tso compile` makes them once" in str(warning.message) for warning in caught] == [
            True
        ] * (not on_disk)


def test_batches_of_tensors_are_compiled_by_their_size_and_type():
    assert use_numba(torch.zeros(2, 4096, 2))
    assert not use_numba(torch.zeros(1, 4096, 2))
    assert not use_numba(torch.zeros(1, 8192, 2, dtype=torch.bfloat16))


@pytest.fixture
def without_numba(monkeypatch):
    monkeypatch.setitem(sys.modules, "numba", None)
    importable.cache_clear()
    yield
    importable.cache_clear()


@pytest.mark.usefixtures("without_numba")
def test_without_numba_numpy_and_torch_do_the_work_and_a_warning_says_so():
    with pytest.warns(UserWarning, match="numba cannot be imported"), planned(1 << 60, 1 << 60):
        assert not use_compiled()


def _python(script: str, **environment: str) -> None:
    process = subprocess.run(
        [sys.executable, "-c", script], env=os.environ | environment, capture_output=True, text=True
    )
    assert process.returncode == 0, process.stderr


@pytest.mark.slow
def test_tso_compile_keeps_every_loop_that_a_refinement_needs(tmp_path):
    """In a process of its own, with an empty folder for machine code."""
    script = (
        "from tso_cli.kernels import dispatch; from tso_cli.refinement.api import compile_loops\n"
    )
    _python(script + "compile_loops(); assert dispatch.on_disk()", NUMBA_CACHE_DIR=str(tmp_path))


REFINE = """
import sys, numpy as np
from tso_cli.refinement import RefineConfig, refine
mask = np.zeros((64, 64), np.float32); mask[20:44, 20:44] = 1.0
points = np.random.default_rng(0).uniform(-0.3, 0.3, (16384, 3))
refine(points, mask, config=RefineConfig(steps=200))
assert 'numba' in sys.modules and 'torch' not in sys.modules
"""


@pytest.mark.slow
def test_refining_a_large_cloud_imports_no_torch():
    _python(REFINE)
