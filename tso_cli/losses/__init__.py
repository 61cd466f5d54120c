"""The losses of a refinement in numpy. Each is a function of points: value and gradient."""
