"""Diffuse laws, one a file: how the incoherent return of a surface depends on angle."""
