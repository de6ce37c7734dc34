"""Wires: what a scene holds of them (`kind`), their series (`cylinder`), their echoes and cost (`source`)."""
