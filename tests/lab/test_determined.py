"""The study of what is determined: each further mask is compared with random ones."""

from __future__ import annotations

import numpy as np
import pytest

from tso_cli.lab.studies import determined
from tso_cli.lab.studies.cases import MASKS, CaseBuilder
from tso_cli.lab.studies.shapes import shapes_of_part

from .studying import MESHES, VALIDATION, holding


@pytest.mark.slow
def test_a_shape_has_a_row_for_each_evidence_and_each_further_mask(split):
    shape = {one.name: one for one in shapes_of_part(MESHES, split, "validation")}[VALIDATION[2]]
    rows = determined._of_shape(CaseBuilder(MESHES, split, MASKS + 1, 64, 1024), shape)
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
    assert list(record["further"]) == ["none", "the suggested one", "a random one", "oblique"]
    first = record["summary"]["1 mask"]["ratio"]
    assert record["further"]["none"]["ratio"] == pytest.approx(first, rel=1e-3)
    assert len(determined.tables(record)) == 2


def test_a_mask_is_compared_with_the_random_one_of_its_shape():
    rows = [
        {"asked": "further", "seen": seen, "shape": shape, "ratio": ratio}
        for shape, ratios in {"a": (0.9, 0.5, 0.6, 0.7), "b": (0.8, 0.7, 0.6, 0.5)}.items()
        for seen, ratio in zip(
            (determined.NONE, determined.SUGGESTED, determined.RANDOM, determined.OBLIQUE),
            ratios,
            strict=True,
        )
    ]
    figures = dict.fromkeys(
        ("determined", "ratio", "error", "along", "across", "error_of_lowest", "error_of_highest"),
        0.5,
    )
    for count in determined.MASK_COUNTS:
        rows.append({"asked": "evidence", "seen": f"{count}", "shape": "a", **figures})
    record = determined.conclude(rows)
    further = record["further"]
    assert holding(record) == [False, False]
    assert further[determined.SUGGESTED]["over_random"] == pytest.approx(0.0)
    assert further[determined.SUGGESTED]["better_than_random"] == 0.5
    assert further[determined.NONE]["over_random"] == pytest.approx(0.25)
    np.testing.assert_allclose(further[determined.RANDOM]["interval"], 0.0)
