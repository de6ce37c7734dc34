"""Volumes of vegetation: what plants are made of, how each piece scatters, the mean over a crown."""
