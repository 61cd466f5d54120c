"""The API page names every argument and field that the code has."""

import dataclasses
import inspect
import re
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

import tso_cli
from tests.readme import DOCS
from tso_cli import Camera, FittedCamera, MaskLoss, RefineConfig, View, refine
from tso_cli.diagnosis.findings import Finding


@pytest.fixture(scope="module")
def named():
    """All names in code font on the page, and in its signatures."""
    page = (DOCS / "api.md").read_text()
    return {word for code in re.findall(r"`([^`]+)`", page) for word in re.findall(r"\w+", code)}


def fields_within(value: Any) -> Iterator[str]:
    """Names of the fields of a data class, and of the data classes that it holds."""
    for field in dataclasses.fields(value):
        yield field.name
        inner = getattr(value, field.name)
        inner = inner[0] if isinstance(inner, (tuple, list)) and inner else inner
        if dataclasses.is_dataclass(inner) and not isinstance(inner, (Camera, type)):
            yield from fields_within(inner)


FUNCTIONS = [
    *(getattr(tso_cli, name) for name in tso_cli.__all__ if name[0].islower()),
    MaskLoss,
]


def test_every_public_name_is_on_the_page(named):
    assert set(tso_cli.__all__) - {"Mode", "Preset"} <= named


@pytest.mark.parametrize("what", FUNCTIONS, ids=lambda what: what.__name__)
def test_the_arguments_of_a_function_are_named(what, named):
    assert set(inspect.signature(what).parameters) <= named


@pytest.mark.parametrize(
    "what",
    [RefineConfig, View, Camera, FittedCamera, Finding],
    ids=lambda what: what.__name__,
)
def test_the_fields_of_a_class_are_named(what, named):
    assert {field.name for field in dataclasses.fields(what)} <= named


def test_the_fields_of_a_result_are_named(named):
    mask = np.zeros((64, 64), np.float32)
    mask[16:48, 16:48] = 1.0
    points = np.random.default_rng(0).uniform(-0.3, 0.3, (200, 3))
    result = refine(points, mask, config=RefineConfig(steps=3))
    assert sorted(set(fields_within(result)) - named) == []
