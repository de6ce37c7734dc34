"""Wires: their objects in a scene (`kind`), their series (`cylinder`), their echoes and cost (`source`)."""
