"""The network of the supplement's tables, and its initialisation."""

import torch

from tso_cli.network.model import BaseNetwork, Decoder, Encoder, build_network


def count(module):
    return sum(parameter.numel() for parameter in module.parameters())


def test_parameter_counts_are_those_of_the_supplement():
    assert count(Encoder()) == 6_272_864
    assert count(Decoder(1024)) == 888_320


def test_every_layer_has_the_size_the_table_states():
    sizes = []
    values = torch.zeros(1, 3, 64, 64)
    for layer in Encoder().convolutions:
        values = layer(values)
        if isinstance(layer, torch.nn.Conv2d):
            sizes.append((values.shape[2], values.shape[1]))
    assert sizes == [(64, 32)] * 2 + [(32, 64)] * 3 + [(16, 128)] * 3 + [(8, 256)] * 3 + [(4, 512)]


def test_images_become_clouds_of_the_given_size_inside_the_cube_of_side_2():
    network = BaseNetwork(Encoder(), Decoder(50))
    points = network(torch.rand(2, 3, 64, 64))
    assert points.shape == (2, 50, 3)
    assert points.abs().max() < 1.0


def test_the_latent_vector_is_linear_and_takes_both_signs():
    latent = build_network(8, seed=0).encoder(torch.rand(4, 3, 64, 64))
    assert latent.shape == (4, 128)
    assert latent.min() < 0.0 < latent.max()


def test_gradients_reach_the_first_convolution_and_images_make_a_difference():
    network = build_network(1024, seed=0)
    images = torch.rand(4, 3, 64, 64, generator=torch.Generator().manual_seed(1))
    images *= torch.linspace(0.3, 1.0, 4)[:, None, None, None]
    points = network(images)
    assert 0.05 < points.std() < 0.5
    assert points.std(0).mean() > 1e-3
    points.square().mean().backward()
    first, *_, last = (parameter.grad for parameter in network.parameters() if parameter.dim() > 1)
    assert first is not None
    assert last is not None
    assert first.square().mean() > 1e-4 * last.square().mean()


def test_the_seed_alone_decides_the_weights_and_the_global_generator_is_left_alone():
    torch.manual_seed(5)
    before = torch.get_rng_state()
    one, same, other = build_network(8, seed=1), build_network(8, seed=1), build_network(8, seed=2)
    assert torch.equal(before, torch.get_rng_state())
    assert all(torch.equal(a, b) for a, b in zip(one.parameters(), same.parameters(), strict=True))
    assert not torch.equal(one.encoder.latent.weight, other.encoder.latent.weight)
