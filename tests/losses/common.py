"""The gradient of a loss by finite differences and by autograd."""

from collections.abc import Callable

import numpy as np
import pytest
import torch

Loss = Callable[[np.ndarray], tuple[float, np.ndarray]]

MODELS = pytest.mark.parametrize("model", ["perspective", "orthographic"])


def by_autograd(
    loss: Callable[[torch.Tensor], torch.Tensor], at: np.ndarray
) -> tuple[float, np.ndarray]:
    """Value and gradient of a loss in torch."""
    leaf = torch.tensor(at, dtype=torch.float64, requires_grad=True)
    value = loss(leaf)
    value.backward()
    return value.item(), leaf.grad.numpy()


def assert_equal(result: tuple, expected: tuple, tolerance: float = 1e-9) -> None:
    """Value and gradient agree to so much of the largest entry."""
    for part, other in zip(result, expected, strict=True):
        np.testing.assert_allclose(
            part, other, rtol=0.0, atol=tolerance * max(np.abs(other).max(), 1e-3)
        )


def assert_gradient(
    loss: Loss, at: np.ndarray, step: float = 1e-6, tolerance: float = 1e-5
) -> None:
    """The gradient is that of central differences, and of the shape of its argument."""
    gradient = loss(at)[1]
    differences = np.empty_like(at)
    for place in np.ndindex(at.shape):
        ahead, back = at.copy(), at.copy()
        ahead[place] += step
        back[place] -= step
        differences[place] = (loss(ahead)[0] - loss(back)[0]) / (2.0 * step)
    np.testing.assert_allclose(
        gradient, differences, rtol=0.0, atol=tolerance * max(np.abs(differences).max(), 1e-3)
    )
