"""The number of control points, in a module that imports nothing: `tso refine --help` reads it."""

# Most control points of a cloud unless more are asked for.
CONTROL_POINTS = 1024
