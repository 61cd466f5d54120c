"""Clouds and meshes: their control points, outliers, and smooth displacement fields."""
