"""The number of control points, in a module that imports nothing: `tso refine --help` reads it."""

# Most control points of a cloud unless more are asked for, and most nodes of a field. The table of
# stages states lambda for this number of nodes.
CONTROL_POINTS = 1024
