"""The shipped chair."""

from __future__ import annotations

import pytest

from ..scenes import Example, example


@pytest.fixture(scope="session")
def chair() -> Example:
    return example("chair")
