"""Reflectors of extensions."""
