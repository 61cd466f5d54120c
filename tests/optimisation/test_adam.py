"""Adam for points, and torch's Adam for weights."""

import subprocess
import sys

import numpy as np
import pytest
import torch

from tso_cli.optimisation.network_parameters import TorchAdam
from tso_cli.optimisation.parameters import PointParameters

GRADIENTS = np.random.default_rng(0).normal(size=(30, 7, 3)) * np.geomspace(1e-9, 10.0, 7)[:, None]


def test_steps_are_those_of_torchs_adam():
    leaf = torch.zeros(7, 3, dtype=torch.float64)
    theirs, mine = torch.optim.Adam([leaf], lr=0.03), PointParameters(np.zeros((7, 3)), 0.03)
    for gradient in GRADIENTS:
        leaf.grad = torch.tensor(gradient)
        theirs.step()
        mine.step(gradient)
        np.testing.assert_allclose(mine.points(), leaf, atol=1e-12)


def _minimised(step_of, parameters) -> list[torch.Tensor]:
    goal = torch.linspace(-1.0, 1.0, 12).view(4, 3)
    for i in range(20):
        # Gradients of sums and transposed matrices are laid out unlike the parameters.
        loss = ((parameters[0] - goal) ** 2).sum() * (1 + i) + parameters[1].square().sum()
        step_of(loss + parameters[2].sum() + (parameters[2].t() ** 2 @ torch.ones(3)).sum())
    return parameters


@pytest.mark.parametrize(("fused", "tolerance"), [(True, 0.0), (False, 1e-6)])
def test_steps_of_weights_are_those_of_torchs_own_optimiser(fused, tolerance):
    def fresh():
        values = torch.ones(4, 3), torch.full((5,), 2.0), torch.linspace(-2.0, 1.0, 12).view(3, 4)
        return [value.requires_grad_() for value in values]

    mine, theirs = fresh(), fresh()
    optimiser, reference = TorchAdam(mine, 0.03), torch.optim.Adam(theirs, lr=0.03, fused=fused)

    def step(loss):
        reference.zero_grad()
        loss.backward()
        reference.step()

    _minimised(lambda loss: optimiser.apply(torch.autograd.grad(loss, mine)), mine)
    _minimised(step, theirs)
    for a, b in zip(mine, theirs, strict=True):
        torch.testing.assert_close(a, b, atol=tolerance, rtol=tolerance)


def test_a_step_of_weights_does_not_import_torchs_compiler():
    code = (
        "import sys, torch; from tso_cli.optimisation.network_parameters import TorchAdam\n"
        "p = torch.ones(3); TorchAdam([p], 0.1).apply([p])\n"
        "assert 'torch._dynamo' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
