"""Sums of Gaussians over a pixel grid, nearest neighbours and losses: plain torch, numba on the CPU, Triton on GPUs."""
