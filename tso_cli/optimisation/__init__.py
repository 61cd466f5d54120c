"""The method: objective, prior, stages, mirror plane, view weights; one loop for all variants."""
