"""Sums of Gaussians over a pixel grid, and nearest neighbours, on the CPU and on GPUs."""
