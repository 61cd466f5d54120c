"""What views ask of a cloud, as terms: functions of points [N, 3] that return a value and its gradient [N, 3]."""
