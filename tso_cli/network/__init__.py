"""The network that predicts a cloud from a photo, and how a photo becomes its input."""
