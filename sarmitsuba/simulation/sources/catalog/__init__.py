"""Kinds of sources, one a file: found by themselves."""
