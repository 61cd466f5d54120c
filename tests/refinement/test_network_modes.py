"""The network modes: which parameters move, from where, and their gradient."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from tso_cli.geometry.camera import Camera
from tso_cli.geometry.view import View
from tso_cli.network.model import Encoder, build_network
from tso_cli.refinement import RefineConfig, refine, run
from tso_cli.refinement.objective import SilhouetteObjective
from tso_cli.refinement.parameters import NetworkParameters
from tso_cli.refinement.resampled_view import resample_view


@pytest.fixture
def photo():
    """A small network, its input image and a mask."""
    mask = np.zeros((64, 64), np.float32)
    mask[22:42, 25:40] = 1.0
    return build_network(points=64), torch.rand(3, 64, 64, generator=torch.Generator().manual_seed(0)), mask


@pytest.mark.parametrize("mode", ["encoder", "encoder-decoder", "latent"])
def test_a_mode_optimises_its_parameters_alone_on_a_copy_of_the_network(mode, photo, monkeypatch):
    network, image, mask = photo
    before = {name: value.clone() for name, value in network.state_dict().items()}
    counts = []
    true_descend = run.descend

    def spy(forward, objective, optimiser, *rest):
        counts.append(sum(p.numel() for p in optimiser._parameters))
        return true_descend(forward, objective, optimiser, *rest)

    monkeypatch.setattr(run, "descend", spy)
    result = refine(None, mask, config=RefineConfig(mode, steps=3, preset="paper"), network=network, image=image)
    assert result.loss_after < result.loss_before
    assert result.gamma == (0.0 if mode == "encoder" else 1e6)
    encoder, decoder = (sum(p.numel() for p in half.parameters()) for half in (network.encoder, network.decoder))
    assert counts == [{"encoder": encoder, "encoder-decoder": encoder + decoder, "latent": 128}[mode]]
    for name, value in network.state_dict().items():
        assert torch.equal(value, before[name])
    assert all(weight.requires_grad and weight.grad is None for weight in network.parameters())


def test_the_latent_vector_starts_at_the_encoders_and_is_decoded_in_each_step(photo):
    network, image, _ = photo
    parameters = NetworkParameters(network, image, "latent", torch.device("cpu"))
    (latent,) = parameters.parameters
    assert latent.shape == (1, 128)
    with torch.no_grad():
        torch.testing.assert_close(torch.tensor(parameters.cloud.initial).float(), network(image[None])[0], rtol=0, atol=1e-6)
        latent += 0.1
        expected = (network.decoder(latent)[0].double().numpy() - parameters.cloud.centre) / parameters.cloud.scale
        np.testing.assert_allclose(parameters.forward()[0].numpy(), expected, atol=1e-6)


def test_the_latent_mode_runs_the_encoder_once(photo, monkeypatch):
    network, image, mask = photo
    calls = []
    true_forward = Encoder.forward
    monkeypatch.setattr(Encoder, "forward", lambda encoder, images: calls.append(1) or true_forward(encoder, images))
    refine(None, mask, config=RefineConfig("latent", steps=4), network=network, image=image)
    assert len(calls) == 1


def test_the_gradient_by_the_latent_vector_is_that_of_finite_differences(photo):
    network, image, mask = photo
    parameters = NetworkParameters(network, image, "latent", torch.device("cpu"))
    parameters._predict.double()
    latent = parameters.parameters[0].detach().double()
    view = resample_view(View(mask, Camera.canonical(64, 64)), 0.4, parameters.cloud.centre, parameters.cloud.scale)
    objective = SilhouetteObjective([[view]], parameters.counts, latent.new_zeros(1, 64, 3))

    def loss(values):
        parameters._input = values
        return objective(parameters.forward())

    assert torch.autograd.gradcheck(loss, latent.requires_grad_(), eps=1e-6, atol=1e-3, rtol=1e-5)
