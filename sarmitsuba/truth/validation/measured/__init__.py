"""Measured bodies: their meshes, tables of measurement and full-wave solver, and the notice of these tables."""
