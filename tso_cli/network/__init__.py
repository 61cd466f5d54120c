"""The network that predicts a cloud from a photo, and its input."""

from typing import Literal

Background = Literal["black", "white", "keep"]  # around the object in the network's input
Frame = Literal["view", "canonical"]  # of the predicted cloud
Supervision = Literal["points", "masks", "joint"]
