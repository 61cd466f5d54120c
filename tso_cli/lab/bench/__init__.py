"""Speed of tso beside other ways to do the same work."""

PARTS = {
    **dict.fromkeys(("command", "object", "batch", "phases"), "refining"),
    "large": "large",
    **dict.fromkeys(("silhouette", "chamfer"), "kernels"),
}
"""What is measured -> the module here whose function `measure_NAME` does it."""
