"""What pictures ask of points: projection, silhouette losses, mask and depth distances."""
