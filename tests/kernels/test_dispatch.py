"""Which form of a kernel runs, when the work is known beforehand."""

from __future__ import annotations

import os
import subprocess
import sys
import warnings

import pytest
import torch

from tso_cli.kernels import dispatch as choice
from tso_cli.kernels.dispatch import planned, use_numba

SMALL, LARGE = torch.zeros(1, 100, 2), torch.zeros(1, 8192, 2)


@pytest.mark.parametrize("kept", [True, False])
def test_all_work_that_is_planned_counts_and_not_its_parts(monkeypatch, kept):
    monkeypatch.setattr(choice, "_on_disk", lambda: kept)
    with planned(1, 1):
        assert not use_numba(LARGE)
    with planned(1_000_000, 100_000_000):
        assert use_numba(SMALL)
        assert not use_numba(SMALL.bfloat16())
        with planned(1, 1):
            assert use_numba(SMALL)
    assert use_numba(LARGE)
    assert not use_numba(SMALL)


def test_work_that_pays_for_loading_but_not_for_compiling_waits_for_what_is_on_disk(monkeypatch):
    fifty_steps = (50, 50 * 16384)
    monkeypatch.setattr(choice, "_on_disk", lambda: True)
    with warnings.catch_warnings(), planned(*fifty_steps):
        warnings.simplefilter("error")
        assert use_numba(SMALL)
    monkeypatch.setattr(choice, "_on_disk", lambda: False)
    with planned(*fifty_steps):
        with pytest.warns(UserWarning, match="`tso compile` makes them once"):
            assert not use_numba(SMALL)
        with warnings.catch_warnings():
            # said once, and the choice stays
            warnings.simplefilter("error")
            assert not use_numba(SMALL)


def test_what_tso_compile_keeps_is_all_that_a_refinement_asks_for(tmp_path):
    """In a process of its own, with an empty folder for machine code."""
    script = """
from tso_cli.kernels import choice
from tso_cli.refinement.run import compile_loops

compile_loops()
print(choice._on_disk())
"""
    found = subprocess.run(
        [sys.executable, "-c", script], env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}, capture_output=True, text=True
    )
    assert found.stdout.splitlines()[-1] == "True", found.stderr
