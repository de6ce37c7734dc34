"""Signals without a scene: raw echoes, focusing, images. NumPy; works on data from elsewhere too."""
