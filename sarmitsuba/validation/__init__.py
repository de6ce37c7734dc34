"""Comparisons of the whole program with theory."""
