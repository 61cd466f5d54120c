"""Folders of images, masks, cameras and shapes."""
