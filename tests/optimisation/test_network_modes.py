"""The network modes: which parameters move, from where, and by which steps."""

import copy

import numpy as np
import pytest
import torch

from tests.scenes import block
from tso_cli import RefineConfig, TsoError, refine
from tso_cli.network.model import build_network
from tso_cli.optimisation.network_parameters import NetworkParameters

MODES = pytest.mark.parametrize("mode", ["encoder", "encoder-decoder", "latent"])


MASK = block(np.s_[22:42, 25:40])
IMAGE = torch.rand(3, 64, 64, generator=torch.Generator().manual_seed(0))


@pytest.fixture
def network():
    return build_network(points=64)


def _refine(network, mode, **settings):
    return refine(
        None, MASK, config=RefineConfig(mode=mode, **settings), network=network, image=IMAGE
    )


@MODES
def test_a_mode_lowers_the_loss_and_leaves_the_network_as_it_was(mode, network):
    before = {name: value.clone() for name, value in network.state_dict().items()}
    result = _refine(network, mode, steps=3, preset="paper")
    assert result.fit.loss_after < result.fit.loss_before
    assert result.settings.gamma == (0.0 if mode == "encoder" else 1e6)
    for name, value in network.state_dict().items():
        assert torch.equal(value, before[name])
    assert all(weight.requires_grad for weight in network.parameters())
    assert all(weight.grad is None for weight in network.parameters())


@MODES
def test_steps_are_adams_on_the_parameters_of_the_mode_alone(mode, network):
    """The latent vector starts at the encoder's output. Gradients come through the decoder."""
    parameters = NetworkParameters(network, IMAGE, mode, "cpu", 1e-3)
    cloud, network = parameters.cloud, copy.deepcopy(network).eval()
    latent = network.encoder(IMAGE[None]).detach().requires_grad_()
    moving = {
        "encoder": network.encoder.parameters(),
        "encoder-decoder": network.parameters(),
        "latent": [latent],
    }[mode]
    optimiser = torch.optim.Adam(moving, lr=1e-3)

    def expected() -> torch.Tensor:
        decoded = network.decoder(latent) if mode == "latent" else network(IMAGE[None])
        return (decoded[0].double() - torch.tensor(cloud.centre)) / cloud.scale

    start = parameters.points()
    np.testing.assert_allclose(start, cloud.start, atol=1e-6)
    for seed in range(3):
        np.testing.assert_allclose(parameters.points(), expected().detach(), atol=1e-4)
        gradient = np.random.default_rng(seed).normal(size=start.shape)
        parameters.step(gradient)
        optimiser.zero_grad()
        (expected() * torch.tensor(gradient)).sum().backward()
        optimiser.step()
    np.testing.assert_allclose(parameters.points(), expected().detach(), atol=1e-4)
    assert np.abs(parameters.points() - start).mean() > 1e-3


def test_the_latent_mode_runs_the_encoder_once(network):
    calls = []
    network.encoder.register_forward_hook(lambda *_: calls.append(1))
    _refine(network, "latent", steps=4)
    assert len(calls) == 1


def test_a_network_whose_first_step_diverges_is_an_error(network):
    with pytest.raises(TsoError, match="a smaller learning rate"):
        _refine(network, "encoder", steps=5, learning_rate=1e4)
