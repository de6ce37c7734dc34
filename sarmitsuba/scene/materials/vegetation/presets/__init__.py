"""Canopy presets, one per file."""
