"""The shipped chair."""

import pytest

from tests.scenes import Example, example


@pytest.fixture(scope="session")
def chair() -> Example:
    return example("chair")
