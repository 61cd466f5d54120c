"""Adam without torch.optim's start-up."""

from __future__ import annotations

import subprocess
import sys

import torch

from tso_cli.adam import Adam


def _descend(step_of, parameters) -> list[torch.Tensor]:
    goal = torch.linspace(-1.0, 1.0, 12).view(4, 3)
    for i in range(20):
        loss = ((parameters[0] - goal) ** 2).sum() * (1 + i) + parameters[1].square().sum()
        step_of(loss)
    return parameters


def test_twenty_steps_are_those_of_torchs_own_optimiser():
    def fresh():
        return [torch.ones(4, 3, requires_grad=True), torch.full((5,), 2.0, requires_grad=True)]

    mine = fresh()
    _descend(Adam(mine, 0.03).step, mine)
    theirs = fresh()
    optimiser = torch.optim.Adam(theirs, lr=0.03)

    def step(loss):
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()

    _descend(step, theirs)
    for a, b in zip(mine, theirs, strict=True):
        assert torch.equal(a, b)


def test_a_step_does_not_import_torchs_compiler():
    code = (
        "import sys, torch; from tso_cli.adam import Adam; p = torch.ones(3, requires_grad=True)\n"
        "Adam([p], 0.1).step(p.sum()); assert 'torch._dynamo' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
