"""Scatterers, one folder a kind, found by the registries.

Wires, volumes, pairs and edges can be deleted: nothing else imports them. Slabs, water and corners are parts of a
surface's return, which the kernel itself computes; currents solve a whole body. Reflectors are those of extensions.
"""
