"""Training the prior that moves a start to a likely shape."""
