"""Surfaces: permittivity, Fresnel coefficients, roughness, diffuse laws."""
