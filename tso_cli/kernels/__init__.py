"""The hot loops: sums of Gaussians over a pixel grid, nearest neighbours."""
