"""The method: objective, prior, mirror plane, view weights."""
