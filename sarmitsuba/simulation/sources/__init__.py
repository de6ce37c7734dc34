"""Scatterers that no ray of a lattice finds: kinds of them, and what a run tells them."""
