"""Formats of city sources, one per file."""
