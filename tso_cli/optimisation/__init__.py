"""The method: objective, prior, displacement field, mirror plane, view weights."""
