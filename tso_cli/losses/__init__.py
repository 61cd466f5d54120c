"""The losses of a refinement in numpy: functions of points that return a value and its gradient."""
