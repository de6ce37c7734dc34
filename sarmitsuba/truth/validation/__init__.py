"""Validation of the whole program against theory."""
