"""Comparisons with theory, one topic a file."""
