"""Volumes: what a scene holds of them (`kind`), their scatterers, extinction and cost (`source`)."""
