"""Speed of tso beside other ways to do the same work."""

PARTS = ("command", "object", "parts", "batch", "silhouette", "chamfer", "training")
"""What is measured; each is the module of that name, by its `measure`."""
