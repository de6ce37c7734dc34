"""Pairs of rough surfaces that light each other."""
