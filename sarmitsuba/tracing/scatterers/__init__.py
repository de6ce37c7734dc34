"""Scatterers, one folder a kind: wires, edges, volumes, pairs, slabs, water, corners, currents."""
