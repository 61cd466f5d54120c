"""Projection, and the losses of projected points against masks and depth maps."""
