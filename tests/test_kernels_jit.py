"""Compiled code that is kept on disk."""

from __future__ import annotations

import os

from tso_cli.kernels.jit import forget_stale


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
