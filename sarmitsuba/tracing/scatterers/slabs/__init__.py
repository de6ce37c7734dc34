"""Slabs: panes and layers that waves pass."""
