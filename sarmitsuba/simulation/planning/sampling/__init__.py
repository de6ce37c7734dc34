"""Sampling of a scene: launch window, resolution cells, ray lattices, pieces of a scene."""
