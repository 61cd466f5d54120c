"""Projection, and the losses of projected points against masks, in torch, for training."""
