"""Wires: nodes of thin conductors."""
