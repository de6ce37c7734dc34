"""Kinds of sources, one module each, found automatically."""
