"""Training the prior that moves a start toward the shape of a mask."""
