"""Radar modes, one a file."""
