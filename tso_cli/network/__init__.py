"""The network that predicts a cloud from a photo, and its input."""
