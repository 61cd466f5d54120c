"""The camera of a picture, estimated from its mask and a cloud alone, in numpy."""

from .fit import Alternative, FittedCamera, fit_camera
