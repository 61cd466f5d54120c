"""Sums of Gaussians over a pixel grid, nearest neighbours, and losses.

Three forms: plain torch, numba on the CPU, Triton on GPUs.
"""
