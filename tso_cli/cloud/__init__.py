"""Clouds and meshes: their control points and outliers."""
