"""The study of what is determined: a row for each evidence."""

from __future__ import annotations

import pytest

from tso_lab.studies import determined
from tso_lab.studies.cases import MASKS, CaseBuilder
from tso_lab.studies.shapes import shapes_of_part

from .studying import MESHES


@pytest.mark.slow
def test_a_shape_has_a_row_for_each_evidence(split):
    builder = CaseBuilder(MESHES, split, MASKS + 1, 64, 1024)
    shapes = shapes_of_part(MESHES, split, "validation")
    rows = [row for shape in shapes for row in determined._of_shape(builder, shape)]
    record = determined.conclude(rows)
    shares = [one["determined"] for one in record["summary"].values()]
    assert list(record["summary"]) == [
        "1 mask",
        "2 masks",
        "4 masks",
        "8 masks",
        "mask and depth map",
    ]
    assert shares[:4] == sorted(shares[:4])
    assert shares[4] > shares[0]
    assert len(determined.tables(record)) == 1
