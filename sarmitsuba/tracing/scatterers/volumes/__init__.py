"""Volumes: their objects in a scene (`kind`), their scatterers, extinction and cost (`source`)."""
