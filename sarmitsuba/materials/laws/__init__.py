"""Diffuse laws, one per file: how the incoherent return of a surface depends on angle."""
