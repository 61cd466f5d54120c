"""Which form of a kernel runs."""

from __future__ import annotations

import os
import subprocess
import sys
import warnings

import pytest
import torch

from tso_cli.kernels import dispatch
from tso_cli.kernels.dispatch import planned, use_numba
from tso_cli.kernels.splat import cheapest

SMALL, LARGE = torch.zeros(1, 100, 2), torch.zeros(1, 8192, 2)


@pytest.mark.parametrize("on_disk", [True, False])
def test_the_whole_plan_decides_and_not_the_size_of_a_batch(monkeypatch, on_disk):
    monkeypatch.setattr(dispatch, "_on_disk", lambda: on_disk)
    with planned(1, 1):
        assert not use_numba(LARGE)
    with planned(1_000_000, 100_000_000):
        assert use_numba(SMALL)
        assert not use_numba(SMALL.bfloat16())
        with planned(1, 1):
            assert use_numba(SMALL)
    assert use_numba(LARGE)
    assert not use_numba(SMALL)


def test_work_that_repays_loading_but_not_compiling_needs_machine_code_on_disk(monkeypatch):
    fifty_steps = (50, 50 * 16384)
    monkeypatch.setattr(dispatch, "_on_disk", lambda: True)
    with warnings.catch_warnings(), planned(*fifty_steps):
        warnings.simplefilter("error")
        assert use_numba(SMALL)
    monkeypatch.setattr(dispatch, "_on_disk", lambda: False)
    with planned(*fifty_steps):
        with pytest.warns(UserWarning, match="`tso compile` makes them once"):
            assert not use_numba(SMALL)
        with warnings.catch_warnings():
            # said once, and the choice stays
            warnings.simplefilter("error")
            assert not use_numba(SMALL)


@pytest.mark.slow
def test_tso_compile_keeps_every_loop_that_a_refinement_needs(tmp_path):
    """In a process of its own, with an empty folder for machine code."""
    script = """
from tso_cli.kernels import dispatch
from tso_cli.refinement.api import compile_loops

compile_loops()
print(dispatch._on_disk())
"""
    process = subprocess.run(
        [sys.executable, "-c", script], env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}, capture_output=True, text=True
    )
    assert process.stdout.splitlines()[-1:] == ["True"], process.stderr


def test_refining_a_small_cloud_does_not_import_numba():
    code = (
        "import sys, numpy as np; from tso_cli.refinement import RefineConfig, refine\n"
        "mask = np.zeros((64, 64), np.float32); mask[20:44, 20:44] = 1.0\n"
        "refine(np.random.default_rng(0).uniform(-0.3, 0.3, (1024, 3)), mask, config=RefineConfig(steps=1))\n"
        "assert 'numba' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_without_numba_torch_does_the_work_and_a_warning_says_so(monkeypatch):
    monkeypatch.setitem(sys.modules, "numba", None)
    dispatch._importable.cache_clear()
    try:
        with pytest.warns(UserWarning, match="numba cannot be imported"):
            assert cheapest(torch.zeros(8, 1024, 2), 64, 64, 0.4) == "windowed"
    finally:
        dispatch._importable.cache_clear()


def test_small_work_and_other_precisions_and_devices_are_left_to_torch():
    assert cheapest(torch.zeros(8, 1024, 2), 64, 64, 0.4) == "compiled"
    assert cheapest(torch.zeros(1, 8191, 2), 64, 64, 0.4) == "windowed"
    assert cheapest(torch.zeros(1, 8191, 2), 20, 20, 6.4) == "exact"
    assert cheapest(torch.zeros(8, 1024, 2, dtype=torch.bfloat16), 64, 64, 0.4) == "windowed"
    assert cheapest(torch.zeros(8, 1024, 2, device="meta"), 64, 64, 0.4) == "windowed"
