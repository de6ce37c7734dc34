"""Diffuse laws, one per file: angular dependence of the incoherent return of surfaces."""
