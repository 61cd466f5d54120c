"""The optimiser: that of torch, and as fast on a processor without bfloat16."""

import pytest
import torch

from tso_cli.train.prior import optimiser
from tso_cli.train.prior.optimiser import (
    LONGEST_GRADIENT,
    MATRIX_RATE,
    OTHER_RATE,
    WEIGHT_DECAY,
    Optimiser,
    orthogonal,
)

SHAPES = {"map1": (8, 3, 3, 3), "map2": (8, 8, 3, 3), "wide": (6, 16), "bias": (6,)}


def weights():
    generator = torch.Generator().manual_seed(0)
    return {name: torch.randn(shape, generator=generator) for name, shape in SHAPES.items()}


def gradients(seed):
    generator = torch.Generator().manual_seed(seed)
    return [torch.randn(shape, generator=generator) for shape in SHAPES.values()]


@pytest.mark.skipif(not hasattr(torch.optim, "Muon"), reason="this torch has no Muon")
def test_matrices_take_the_steps_of_muon_and_other_weights_those_of_adamw(monkeypatch):
    monkeypatch.setattr(optimiser, "has_bfloat16", lambda device: True)
    ours, theirs = weights(), weights()
    course = Optimiser(ours)
    matrices = [theirs[name].flatten(1).requires_grad_() for name in ("map2", "wide")]
    others = [theirs[name].requires_grad_() for name in ("map1", "bias")]
    muon = torch.optim.Muon(
        matrices, lr=MATRIX_RATE, weight_decay=WEIGHT_DECAY, adjust_lr_fn="match_rms_adamw"
    )
    adam = torch.optim.AdamW(others, lr=OTHER_RATE, weight_decay=WEIGHT_DECAY, fused=True)
    for seed in range(3):
        course.step(gradients(seed), 1.0)
        of_map1, of_map2, of_wide, of_bias = gradients(seed)
        matrices[0].grad, matrices[1].grad = of_map2.flatten(1), of_wide
        others[0].grad, others[1].grad = of_map1, of_bias
        torch.nn.utils.clip_grad_norm_([*matrices, *others], LONGEST_GRADIENT)
        muon.step()
        adam.step()
    for name in SHAPES:
        assert torch.equal(ours[name], theirs[name].detach()), name


@pytest.mark.parametrize("shape", [(12, 40), (40, 12), (16, 16)])
def test_the_orthogonal_factor_in_float32_is_that_in_bfloat16(shape):
    matrix = torch.randn(shape, generator=torch.Generator().manual_seed(0))
    exact = orthogonal(matrix, torch.float32)
    assert (torch.linalg.svdvals(exact) - 1.0).abs().max() < 0.5
    rough = orthogonal(matrix, torch.bfloat16).float()
    assert (rough - exact).norm() < 0.03 * exact.norm()
