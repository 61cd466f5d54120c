"""Exponentials and logarithms in compiled loops."""

import numpy as np
import pytest
from numba import njit

from tso_cli.kernels import simd


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_exponentials_and_logarithms_are_those_of_numpy(dtype):
    @njit
    def both(x, powers, logs):
        for i in range(len(x)):
            powers[i], logs[i] = simd.exp(-x[i]), simd.log(x[i])

    x = np.geomspace(1e-30, 80.0, 20001).astype(dtype)
    powers, logs = np.empty_like(x), np.empty_like(x)
    both(x, powers, logs)
    near = x < 1.0
    exact = np.exp(-x.astype(np.float64))
    precision = 3e-7 if dtype == np.float32 else 1e-15
    np.testing.assert_allclose(powers[near], exact[near], rtol=precision)
    np.testing.assert_allclose(powers, exact, rtol=20 * precision)
    np.testing.assert_allclose(logs, np.log(x.astype(np.float64)), rtol=precision, atol=precision)
