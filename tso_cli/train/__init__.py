"""Training the network that predicts a cloud from a photo, and the learned prior."""
