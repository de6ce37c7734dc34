"""Corners of metal."""
