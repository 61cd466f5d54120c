"""Cameras, views, points and rotations: arrays in, arrays out. torch is not needed."""
