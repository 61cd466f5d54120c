"""A split of shipped shapes, and networks that are small."""

from __future__ import annotations

from pathlib import Path

import pytest

from ..training import make_thin
from .studying import TEST, TRAIN, VALIDATION, write_split


@pytest.fixture(scope="session")
def split(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("split")
    return write_split(folder, train=TRAIN, validation=VALIDATION, test=TEST)


@pytest.fixture
def thin(monkeypatch: pytest.MonkeyPatch) -> None:
    """Networks with few channels."""
    make_thin(monkeypatch)
