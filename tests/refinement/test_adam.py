"""Adam without torch.optim's start-up."""

from __future__ import annotations

import subprocess
import sys

import pytest
import torch

from tso_cli.refinement.adam import Adam


def _descend(step_of, parameters) -> list[torch.Tensor]:
    goal = torch.linspace(-1.0, 1.0, 12).view(4, 3)
    for i in range(20):
        # sums and transposed matrices: their gradients are laid out unlike the parameters
        loss = ((parameters[0] - goal) ** 2).sum() * (1 + i) + parameters[1].square().sum()
        loss = loss + parameters[2].sum() + (parameters[2].t() ** 2 @ torch.ones(3)).sum()
        step_of(loss)
    return parameters


@pytest.mark.parametrize(("fused", "tolerance"), [(True, 0.0), (False, 1e-6)])
def test_twenty_steps_are_those_of_torchs_own_optimiser(fused, tolerance):
    def fresh():
        values = torch.ones(4, 3), torch.full((5,), 2.0), torch.linspace(-2.0, 1.0, 12).view(3, 4)
        return [value.requires_grad_() for value in values]

    mine = fresh()
    _descend(Adam(mine, 0.03).step, mine)
    theirs = fresh()
    optimiser = torch.optim.Adam(theirs, lr=0.03, fused=fused)

    def step(loss):
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()

    _descend(step, theirs)
    for a, b in zip(mine, theirs, strict=True):
        torch.testing.assert_close(a, b, atol=tolerance, rtol=tolerance)


def test_a_step_does_not_import_torchs_compiler():
    code = (
        "import sys, torch; from tso_cli.refinement.adam import Adam; p = torch.ones(3, requires_grad=True)\n"
        "Adam([p], 0.1).step(p.sum()); assert 'torch._dynamo' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
