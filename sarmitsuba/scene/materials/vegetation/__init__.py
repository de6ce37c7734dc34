"""Vegetation volumes: permittivity of plants, scattering by single pieces, mean over a canopy."""
