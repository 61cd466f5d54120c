"""Arrays packed into JSON."""

from __future__ import annotations

import json

import numpy as np

from tso_cli.lab.packing import pack, unpack


def test_packed_arrays_come_back_to_half_a_step():
    values = np.random.default_rng(0).uniform(-3.0, 70.0, (5, 2))
    np.testing.assert_allclose(unpack(pack(values, 1 / 32)), values, atol=1 / 64)
    mask = np.linspace(0.0, 1.0, 12).reshape(3, 4)
    packed = json.loads(json.dumps(pack(mask, 1 / 255)))
    assert packed["type"] == "uint8"
    np.testing.assert_allclose(unpack(packed), mask, atol=1 / 510)
    assert unpack(pack(np.array([-1.0, 2.0]), 1.0)).tolist() == [-1.0, 2.0]
    assert unpack(pack(np.array([np.nan, 1e9]), 0.5)).tolist() == [16383.5, 16383.5]
