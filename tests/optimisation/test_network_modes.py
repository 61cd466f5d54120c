"""The network modes: which parameters move, from where, and their gradient."""

import numpy as np
import pytest
import torch

from tests.scenes import block
from tso_cli import Camera, RefineConfig, TsoError, View, refine
from tso_cli.network.model import Encoder, build_network
from tso_cli.optimisation.network_parameters import NetworkParameters
from tso_cli.optimisation.objective import SilhouetteObjective
from tso_cli.optimisation.resampled_view import resample_view

MODES = pytest.mark.parametrize("mode", ["encoder", "encoder-decoder", "latent"])


MASK = block(np.s_[22:42, 25:40])
IMAGE = torch.rand(3, 64, 64, generator=torch.Generator().manual_seed(0))


@pytest.fixture
def network():
    return build_network(points=64)


def _refine(network, mode, **settings):
    return refine(None, MASK, config=RefineConfig(mode, **settings), network=network, image=IMAGE)


@MODES
def test_a_mode_optimises_its_parameters_alone_on_a_copy_of_the_network(mode, network):
    before = {name: value.clone() for name, value in network.state_dict().items()}
    result = _refine(network, mode, steps=3, preset="paper")
    assert result.loss_after < result.loss_before
    assert result.gamma == (0.0 if mode == "encoder" else 1e6)
    moving = NetworkParameters(network, IMAGE, mode, "cpu", 1e-3)._optimiser.parameters
    encoder, decoder = (
        sum(p.numel() for p in half.parameters()) for half in (network.encoder, network.decoder)
    )
    expected = {"encoder": encoder, "encoder-decoder": encoder + decoder, "latent": 128}[mode]
    assert sum(parameter.numel() for parameter in moving) == expected
    for name, value in network.state_dict().items():
        assert torch.equal(value, before[name])
    assert all(weight.requires_grad and weight.grad is None for weight in network.parameters())


def test_the_latent_vector_starts_at_the_encoders_and_is_decoded_in_each_step(network):
    parameters = NetworkParameters(network, IMAGE, "latent", "cpu", 1e-3)
    (latent,) = parameters._optimiser.parameters
    assert latent.shape == (1, 128)
    with torch.no_grad():
        np.testing.assert_allclose(
            parameters.cloud.initial, network(IMAGE[None])[0], rtol=0, atol=1e-6
        )
        latent += 0.1
        expected = (
            network.decoder(latent)[0].double().numpy() - parameters.cloud.centre
        ) / parameters.cloud.scale
    np.testing.assert_allclose(parameters.forward()[0], expected, atol=1e-6)


def test_the_latent_mode_runs_the_encoder_once(network, monkeypatch):
    calls, true_forward = [], Encoder.forward
    monkeypatch.setattr(
        Encoder, "forward", lambda encoder, images: calls.append(1) or true_forward(encoder, images)
    )
    _refine(network, "latent", steps=4)
    assert len(calls) == 1


@MODES
def test_the_gradient_by_the_parameters_is_that_of_finite_differences(mode, network):
    parameters = NetworkParameters(network, IMAGE, mode, "cpu", 1e-3)
    parameters._predict.double()
    parameters._input.data = parameters._input.data.double()
    view = resample_view(
        View(MASK, Camera.canonical(64, 64)), 0.4, parameters.cloud.centre, parameters.cloud.scale
    )
    objective, gradients = SilhouetteObjective([view], [1.0]), []
    parameters._optimiser.apply = gradients.extend
    points, step_down = parameters.forward()
    step_down(objective(points)[1])
    moving = parameters._optimiser.parameters
    for parameter, gradient in [*zip(moving, gradients, strict=True)][:: max(1, len(moving) // 4)]:
        place = int(gradient.abs().argmax())
        values = parameter.data.view(-1)
        losses = []
        for step in (1e-6, -2e-6):
            values[place] += step
            losses.append(objective(parameters.forward()[0])[0])
        assert float(gradient.reshape(-1)[place]) == pytest.approx(
            (losses[0] - losses[1]) / 2e-6, rel=1e-3, abs=1e-6
        )
        values[place] += 1e-6


def test_a_network_whose_first_step_diverges_is_an_error(network):
    with pytest.raises(TsoError, match="a smaller learning rate"):
        _refine(network, "encoder", steps=5, learning_rate=1e4)
